//! Robustness margins: the longest outage and delay and the highest message-loss rate that a control loop survives, and
//! the worst outage of a flight compared with them.

use crate::comparison::Laws;
use crate::outages::OutageSection;
use crate::schema::{MACHINE, MarginSection, RobustnessMargin};
use flight_log::build::Build;
use messages::role::STAGES;
use serde::{Deserialize, Serialize};

pub const SCHEMA: &str = "ironbird-margin/1";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    pub schema: String,
    pub build: Build,
    pub trajectory: String,
    pub airframe: String,
    /// Preset of the laws that have one of that name.
    pub preset: String,
    /// Seed of the first flight with losses, and of the sensors' noise.
    pub seed: u64,
    pub period_s: f64,
    /// When faults begin: a flight for each of these instants [s].
    pub phases_s: Vec<f64>,
    /// Over how much of the trajectory they are spread [s].
    pub span_s: f64,
    /// After which time the trajectory repeats [s]; none where it does not.
    pub cycle_s: Option<f64>,
    /// Every so many phases, what takes more flights is flown, beginning with the first.
    pub sparse: usize,
    pub longest_ticks: u64,
    pub steady_s: f64,
    pub gate: Gate,
    /// In the order in which the laws were named.
    pub laws: Vec<LawMargins>,
}

/// What counts as survived: the flight's envelope kept, and these limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// A bound for the position error that was given [m]; else it follows from each law's unfaulted flight.
    pub recovered_below_m: Option<f64>,
    /// Position error up to which a flight under a steady fault is tracked, where no bound was given [m].
    pub tracked_below_m: f64,
    /// Time until the error must be below for good: after an outage, or after a steady fault has begun [s].
    pub recovery_max_s: f64,
    /// Limits that were given besides: name of the metric, the most that it may be.
    pub limits: Vec<(String, f64)>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawMargins {
    pub laws: Laws,
    pub fingerprint: String,
    /// The largest position error of the flights without a fault, one for each phase's seed, from the first phase on [m].
    pub unfaulted_error_m: f64,
    /// Ticks in which the rotors were saturated in the worst of them [%].
    pub unfaulted_saturated_percent: f64,
    /// The widest bound of the position error after an outage: each phase has that of its own flight without a fault [m].
    pub recovered_below_m: f64,
    pub tracked_below_m: f64,
    /// Likewise ticks in which the rotors may be saturated under a steady fault [%].
    pub saturated_max_percent: f64,
    pub outages: Vec<OutageMargin>,
    /// Steady dead time: the input is in time, and its content so many ticks old.
    pub lags: Vec<SteadyMargin>,
    /// Steady delay: the input comes so many ticks late, and the stage knows.
    pub delays: Vec<SteadyMargin>,
    pub losses: Vec<LossMargin>,
    pub patterns: Vec<PatternMargin>,
    pub flights: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutageMargin {
    /// What is out: a stage, `machine` for all of them, or an input as `inner.state`.
    pub of: String,
    /// At each phase, the longest survived [ticks]; the longest that was tried where that was survived, too.
    pub ticks: Vec<u64>,
    pub exceptions: Vec<Exception>,
}

/// An outage that was survived although a shorter one was not, or the other way round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exception {
    pub phase_s: f64,
    pub ticks: u64,
    pub survived: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SteadyMargin {
    pub input: String,
    /// The most ticks up to which all flights survived.
    pub ticks: u64,
    /// Whether that is the most that can be requested.
    pub is_most: bool,
    /// What was flown, up to where the first phase flew no further.
    pub points: Vec<Point>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LossMargin {
    pub input: String,
    /// The largest share of messages lost up to which every flight survived.
    pub share: f64,
    /// Flights at that share with seeds that it was not found with, one for each phase; none where it is 0.
    pub flights: u64,
    pub survived: u64,
    /// The probability of survival at that share, by them: its exact interval at 95 %.
    pub survival: [f64; 2],
    /// Half of the flights survived at least this share.
    pub median_share: f64,
    /// What was flown, up to where the first phase flew no further.
    pub points: Vec<Point>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub at: f64,
    pub flights: u64,
    pub survived: u64,
    /// The largest position error of the last 5 s in any of them [m]; none where one left the envelope.
    pub error_m: Option<f64>,
}

/// The weakest pattern survived: the first m of each k messages lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PatternMargin {
    pub input: String,
    /// For each k the largest m, as m and k.
    pub most: Vec<[u64; 2]>,
}

impl OutageMargin {
    /// The least over all phases [ticks].
    pub fn least(&self) -> u64 {
        self.ticks.iter().copied().min().unwrap_or(0)
    }

    /// Half of the phases tolerate at least this [ticks].
    pub fn median(&self) -> u64 {
        let mut sorted = self.ticks.clone();
        sorted.sort_unstable();
        let middle = sorted.len().saturating_sub(1) / 2;
        sorted.get(middle).copied().unwrap_or(0)
    }
}

impl PatternMargin {
    /// The pattern that loses the largest share; of those alike, the one with the longest row.
    pub fn weakest(&self) -> Option<[u64; 2]> {
        let most = self.most.iter().copied();
        most.max_by(|[m, k], [n, l]| (m * l, m).cmp(&(n * k, n)))
    }
}

impl Margins {
    /// The name of a combination: its mixer only where they differ.
    pub fn name_of(&self, laws: &Laws) -> String {
        laws.name(Laws::mixers_differ(self.laws.iter().map(|law| &law.laws)))
    }
}

/// The least bound of the position error after an outage, where none is given [m].
pub const SMALLEST_BOUND_M: f64 = 0.01;
/// A bound that is not given is so many times the largest error without a fault.
pub const TIMES_UNFAULTED: f64 = 2.0;
pub const SATURATED: &str = "saturated_percent";
/// Ticks that may be saturated under a steady fault, beyond those without one, where no limit is given [%].
pub const SATURATED_MORE_PERCENT: f64 = 10.0;

impl MarginSection {
    /// Of a flight without measured margins; `command` measures them.
    pub fn unknown(fingerprint: String, command: String) -> Self {
        Self {
            fingerprint,
            unknown: Some(command),
            ..Self::default()
        }
    }

    /// Of a flight of a build, with the margins of a table; none if the table is of other settings or lacks
    /// a stage.
    pub fn known(fingerprint: &str, table: &Margins, build: &Build) -> Option<Self> {
        let law = table
            .laws
            .iter()
            .find(|law| law.fingerprint == fingerprint)?;
        let tolerated = |of: &str| {
            let mut known = law.outages.iter().filter(|margin| !margin.ticks.is_empty());
            let ticks = known.find(|margin| margin.of == of)?.least();
            let is_most = ticks >= table.longest_ticks;
            Some((of.to_owned(), RobustnessMargin { ticks, is_most }))
        };
        let stages = STAGES.into_iter().map(|role| role.name());
        let tolerated = stages
            .chain([MACHINE])
            .map(tolerated)
            .collect::<Option<_>>()?;
        let phases = table.phases_s.len() as u64;
        let measured_by = (table.build != *build).then(|| table.build.token());
        Some(Self {
            fingerprint: fingerprint.into(),
            tolerated,
            phases,
            measured_by,
            ..Self::default()
        })
    }

    pub fn with(mut self, outages: &OutageSection) -> Self {
        // A report from before they were counted keeps what it says.
        if let Some(longest) = &outages.longest {
            self.outages.clone_from(longest);
            self.unmeasured = outages.unmeasured;
        }
        let ratio = |(stage, outage): (&String, &u64)| {
            let tolerated = self.tolerated.get(stage)?.ticks;
            Some((tolerated as f64 / *outage as f64, stage.clone()))
        };
        let ratios = self.outages.iter().filter_map(ratio);
        let nearest = ratios.min_by(|a, b| a.0.total_cmp(&b.0));
        (self.margin, self.nearest) = nearest.unzip();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_and_median_are_those_of_the_phases() {
        let of = |ticks: &[u64]| {
            let margin = OutageMargin {
                of: "outer".into(),
                ticks: ticks.into(),
                exceptions: Vec::new(),
            };
            (margin.least(), margin.median())
        };
        assert_eq!(of(&[5, 1, 9]), (1, 5));
        assert_eq!(of(&[4, 1, 9, 5]), (1, 4), "half of them bear it");
        assert_eq!(of(&[]), (0, 0));
    }

    #[test]
    fn the_weakest_pattern_loses_the_largest_share() {
        let of = |most: &[[u64; 2]]| {
            let (input, most) = (String::new(), most.into());
            PatternMargin { input, most }.weakest()
        };
        assert_eq!(of(&[[1, 2], [3, 5], [5, 10]]), Some([3, 5]));
        // The longer row of the same share.
        assert_eq!(of(&[[1, 2], [5, 10], [0, 20]]), Some([5, 10]));
        assert_eq!(of(&[]), None);
    }

    fn outages(all: &[(&str, u64)], unmeasured: u64) -> OutageSection {
        let longest = all
            .iter()
            .map(|(stage, ticks)| ((*stage).to_owned(), *ticks));
        OutageSection {
            longest: Some(longest.collect()),
            unmeasured,
            ..OutageSection::default()
        }
    }

    #[test]
    fn the_smallest_margin_counts_and_not_the_longest_outage() {
        let tolerated = |(stage, ticks): (&str, u64)| {
            let is_most = ticks >= 2000;
            (stage.to_owned(), RobustnessMargin { ticks, is_most })
        };
        let known = MarginSection {
            tolerated: [("outer", 2000), ("inner", 118), ("machine", 30)]
                .map(tolerated)
                .into(),
            ..MarginSection::default()
        };
        let unknown = MarginSection::unknown("ab".into(), String::new());
        for (section, all, nearest, margin) in [
            (
                &known,
                &[("inner", 47), ("outer", 300)][..],
                Some("inner"),
                Some(118.0 / 47.0),
            ),
            (
                &known,
                &[(MACHINE, 20), ("inner", 47)],
                Some(MACHINE),
                Some(1.5),
            ),
            (&known, &[], None, None),
            (&unknown, &[(MACHINE, 5)], None, None),
        ] {
            let section = section.clone().with(&outages(all, 2));
            assert_eq!(
                (section.nearest.as_deref(), section.margin),
                (nearest, margin)
            );
            assert_eq!((section.outages.len(), section.unmeasured), (all.len(), 2));
        }
    }
}
