//! Robustness margins: the longest outage and delay and the highest message-loss rate that a control loop survives, and
//! the worst outage of a flight compared with them.

use crate::comparison::Laws;
use crate::outages::OutageSection;
use crate::recovery::RecoveryBounds;
use crate::schema::{MACHINE, MarginSection, RobustnessMargin};
use flight_log::build::Build;
use messages::role::STAGES;
use serde::{Deserialize, Serialize};

pub const SCHEMA: &str = "ironbird-margin/4";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    pub schema: String,
    pub build: Build,
    pub trajectory: String,
    pub airframe: String,
    /// Preset of the laws that have one of that name.
    pub preset: String,
    /// Seed of the first phase.
    pub seed: u64,
    pub period_s: f64,
    /// When faults begin: flights for each of these instants [s].
    pub phases_s: Vec<f64>,
    /// Over how much of the trajectory they are spread [s].
    pub span_s: f64,
    /// After which time the trajectory repeats [s]; none where it does not.
    pub cycle_s: Option<f64>,
    pub longest_ticks: u64,
    /// Every so many phases, patterns of losses are flown, beginning with the first.
    pub sparse: usize,
    pub bounds: Bounds,
    /// In the order in which the laws were named.
    pub laws: Vec<LawMargins>,
}

/// The limits of a loop, the same for all laws: what is unnoticed recovers, and what recovers survives. Calm is separate:
/// it implies survives, and exists for a steady lag, delay or gain alone.
pub const LIMITS: [&str; 4] = ["unnoticed", "recovers", "survives", "calm"];
pub const UNNOTICED: usize = 0;
pub const RECOVERS: usize = 1;
pub const SURVIVES: usize = 2;
pub const CALM: usize = 3;

/// What the limits mean, for a flight that keeps its envelope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Position error from the fault on [m]: unnoticed.
    pub unnoticed_below_m: f64,
    /// Yaw error from the fault on [rad]: unnoticed.
    pub unnoticed_yaw_below_rad: f64,
    /// Position error of a flight that is back on its trajectory [m].
    pub recovered_below_m: f64,
    /// Yaw error of a flight that is back on its trajectory [rad].
    pub recovered_yaw_below_rad: f64,
    /// Time until the errors are below those and stay: recovers [s].
    pub recovery_max_s: f64,
    /// Likewise: survives [s].
    pub survival_max_s: f64,
    /// Change of the body rate per tick under a steady fault, beyond that without one (root of the difference of their mean
    /// squares) [rad/s]: more is a limit cycle.
    pub rate_step_increase_rad_s: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawMargins {
    pub laws: Laws,
    /// The preset that it flew with; empty in tables of earlier versions.
    #[serde(default)]
    pub preset: String,
    pub fingerprint: String,
    /// The worst flight without a fault.
    pub unfaulted: Point,
    /// Whether its error is within the bound of each limit. A law that is not qualified has no such limit.
    pub qualified: [bool; LIMITS.len()],
    pub searches: Vec<Search>,
    pub predicted: Prediction,
    pub flights: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A stage does nothing, or an input loses all messages, for so many ticks.
    Outage,
    /// Steady dead time: the input is in time, and its content so many ticks old.
    Lag,
    /// Steady delay: the input comes so many ticks late, and the stage knows.
    Delay,
    /// So many per cent of the messages are lost at random.
    Loss,
    /// The first so many of every k messages are lost.
    Pattern(u64),
    /// Inertia and rotational drag are divided by 1 and so many tenths.
    Gain,
}

/// Flights with a fault of growing strength.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    pub kind: Kind,
    /// A stage, `machine` for all of them, or an input as `inner.state`.
    pub of: String,
    /// The greatest strength that may be tried.
    pub most: u64,
    /// The greatest strength up to which all flights hold each of [`LIMITS`]; none if the law is not qualified.
    pub limits: [Option<u64>; LIMITS.len()],
    /// What was flown, by ascending strength.
    pub points: Vec<Point>,
    /// Of losses: flights with other seeds at the share that is survived, and how many survived it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeated: Option<[u64; 2]>,
}

/// The worst of the flights, one for each phase, with a fault of one strength.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub at: u64,
    /// Largest position error from the fault on [m]; none where a flight left its envelope.
    pub peak_m: Option<f64>,
    /// Largest yaw error from the fault on [rad]; none where a flight left its envelope.
    pub peak_yaw_rad: Option<f64>,
    /// Time until the errors were below their bounds and stayed, from the end of an outage or from the beginning of a steady
    /// fault [s]; none where it did not.
    pub recovery_s: Option<f64>,
    /// Change of the body rate per tick, beyond that of the flight without a fault: root of the difference of their mean
    /// squares [rad/s]; of that flight itself, the whole change.
    pub rate_step_increase_rad_s: f64,
    /// Why the first flight that did not survive failed.
    pub cause: Option<Cause>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Cause {
    Ground,
    Tilt,
    /// The position error exceeds that of the envelope.
    Position,
    /// The state is no longer finite.
    Diverged,
    /// Within its envelope, but the position error is not below its bound in time.
    Error,
    /// Within its envelope, but the yaw error is not below its bound in time.
    Yaw,
}

/// Stability margins of the loop through the rotors, at hover.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Prediction {
    /// The axes that settle after an impulse; none if no prediction was requested.
    pub axes: Vec<LoopMargin>,
    /// The axes whose response to an impulse does not decay. With one of them the loop has no margin.
    pub unsettled: Vec<String>,
}

/// Stability margins of one axis at hover, by the frequency response of its sampled loop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopMargin {
    pub axis: String,
    /// Where the loop's gain is 1, at the crossover that allows the least delay [rad/s].
    pub crossover_rad_s: Option<f64>,
    pub phase_margin_deg: Option<f64>,
    /// Additional dead time at which the loop becomes unstable [ticks].
    pub delay_ticks: Option<f64>,
    /// Factor above 1 of the loop's gain at which it becomes unstable; another cut of the loop than the numbers before.
    pub gain: Option<f64>,
}

impl Bounds {
    pub const fn unnoticed(&self) -> RecoveryBounds {
        RecoveryBounds {
            position_m: self.unnoticed_below_m,
            yaw_rad: self.unnoticed_yaw_below_rad,
        }
    }

    pub const fn recovered(&self) -> RecoveryBounds {
        RecoveryBounds {
            position_m: self.recovered_below_m,
            yaw_rad: self.recovered_yaw_below_rad,
        }
    }

    pub fn hold(&self, limit: usize, point: &Point) -> bool {
        point.cause.is_none()
            && match limit {
                UNNOTICED => point.peaks_hold(&self.unnoticed()),
                RECOVERS => point.recovery_s.is_some_and(|it| it <= self.recovery_max_s),
                CALM => point.rate_step_increase_rad_s <= self.rate_step_increase_rad_s,
                _ => true,
            }
    }

    /// Which limits laws are qualified for that fly like this without a fault.
    pub fn qualified(&self, unfaulted: &Point) -> [bool; LIMITS.len()] {
        std::array::from_fn(|limit| {
            let bounds = match limit {
                UNNOTICED => self.unnoticed(),
                _ => self.recovered(),
            };
            unfaulted.cause.is_none() && unfaulted.peaks_hold(&bounds)
        })
    }
}

impl Prediction {
    /// The axis with the least of a margin, and that margin; none if an axis does not settle.
    pub fn least(&self, of: fn(&LoopMargin) -> Option<f64>) -> Option<(f64, &LoopMargin)> {
        let axes = self.axes.iter().filter_map(|it| Some((of(it)?, it)));
        let least = axes.min_by(|a, b| a.0.total_cmp(&b.0));
        least.filter(|_| self.unsettled.is_empty())
    }
}

impl Point {
    fn peaks_hold(&self, bounds: &RecoveryBounds) -> bool {
        let peaks = self.peak_m.zip(self.peak_yaw_rad);
        peaks.is_some_and(|(peak_m, yaw_rad)| bounds.hold(peak_m, yaw_rad))
    }

    pub fn worse(self, other: Self) -> Self {
        let max = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a.max(b));
        Self {
            at: self.at,
            peak_m: max(self.peak_m, other.peak_m),
            peak_yaw_rad: max(self.peak_yaw_rad, other.peak_yaw_rad),
            recovery_s: max(self.recovery_s, other.recovery_s),
            rate_step_increase_rad_s: self
                .rate_step_increase_rad_s
                .max(other.rate_step_increase_rad_s),
            cause: self.cause.or(other.cause),
        }
    }
}

impl Search {
    pub fn take(&mut self, point: Point) {
        match self.points.binary_search_by_key(&point.at, |it| it.at) {
            Ok(i) => self.points[i] = self.points[i].worse(point),
            Err(i) => self.points.insert(i, point),
        }
    }

    /// The greatest strength up to which every point holds a limit.
    pub fn greatest(&self, limit: usize, bounds: &Bounds) -> u64 {
        let held = self.points.iter().take_while(|it| bounds.hold(limit, it));
        held.last().map_or(0, |it| it.at)
    }

    pub fn beyond(&self, strength: u64) -> Option<&Point> {
        self.points.iter().find(|point| point.at > strength)
    }
}

impl LawMargins {
    pub fn search(&self, kind: Kind, of: &str) -> Option<&Search> {
        let mut searches = self.searches.iter();
        searches.find(|search| search.kind == kind && search.of == of)
    }
}

impl Margins {
    /// The name of a combination: its mixer only where they differ.
    pub fn name_of(&self, laws: &Laws) -> String {
        laws.name(Laws::mixers_differ(self.laws.iter().map(|law| &law.laws)))
    }
}

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
        let tolerated = |limit: usize| {
            let of = |of: &str| {
                let ticks = law.search(Kind::Outage, of)?.limits[limit]?;
                let is_most = ticks >= table.longest_ticks;
                Some((of.to_owned(), RobustnessMargin { ticks, is_most }))
            };
            let stages = STAGES.into_iter().map(|role| role.name());
            stages.chain([MACHINE]).map(of).collect::<Option<_>>()
        };
        let phases = table.phases_s.len() as u64;
        let measured_by = (table.build != *build).then(|| table.build.token());
        Some(Self {
            fingerprint: fingerprint.into(),
            tolerated: tolerated(SURVIVES)?,
            recovers: tolerated(RECOVERS)?,
            phases,
            measured_by,
            ..Self::default()
        })
    }

    pub fn with(mut self, outages: &OutageSection) -> Self {
        self.outages.clone_from(&outages.longest);
        self.unmeasured = outages.unmeasured;
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
    fn the_worst_flight_of_a_strength_counts_and_the_first_failure_ends_a_limit() {
        let bounds = Bounds {
            unnoticed_below_m: 0.02,
            unnoticed_yaw_below_rad: 0.02,
            recovered_below_m: 0.1,
            recovered_yaw_below_rad: 0.1,
            recovery_max_s: 5.0,
            survival_max_s: 20.0,
            rate_step_increase_rad_s: 0.05,
        };
        let flown = |at, peak_m, recovery_s, cause| Point {
            at,
            peak_m: Some(peak_m),
            peak_yaw_rad: Some(0.0),
            recovery_s: Some(recovery_s),
            rate_step_increase_rad_s: 0.0,
            cause,
        };
        let mut search = Search {
            kind: Kind::Outage,
            of: "inner".into(),
            most: 2000,
            limits: [None; LIMITS.len()],
            points: Vec::new(),
            repeated: None,
        };
        for point in [
            flown(300, 1.2, 6.0, None),
            flown(100, 0.2, 2.0, None),
            flown(10, 0.01, 0.0, None),
            // Another phase of the same strength.
            flown(10, 0.005, 0.0, None),
            flown(100, 0.1, 3.0, None),
            // An exception beyond a failure counts for nothing.
            flown(400, 2.0, 9.0, Some(Cause::Ground)),
            flown(500, 0.01, 1.0, None),
        ] {
            search.take(point);
        }
        assert_eq!(search.points[1], flown(100, 0.2, 3.0, None));
        let limits = [UNNOTICED, RECOVERS, SURVIVES].map(|it| search.greatest(it, &bounds));
        assert_eq!(limits, [10, 100, 300]);
        assert_eq!(search.beyond(300).unwrap().cause, Some(Cause::Ground));
        for (peak_m, cause, qualified) in [
            (0.01, None, [true; LIMITS.len()]),
            (0.05, None, [false, true, true, true]),
            (0.2, None, [false; LIMITS.len()]),
            (0.01, Some(Cause::Tilt), [false; LIMITS.len()]),
        ] {
            let unfaulted = flown(0, peak_m, 0.0, cause);
            assert_eq!(bounds.qualified(&unfaulted), qualified);
        }
        for (yaw_rad, qualified) in [
            (0.02, [true; LIMITS.len()]),
            (0.05, [false, true, true, true]),
            (0.2, [false; LIMITS.len()]),
        ] {
            let turned = Point {
                peak_yaw_rad: Some(yaw_rad),
                ..flown(0, 0.0, 0.0, None)
            };
            assert_eq!(bounds.qualified(&turned), qualified);
            assert_eq!(bounds.hold(UNNOTICED, &turned), qualified[UNNOTICED]);
        }
    }

    fn outages(all: &[(&str, u64)], unmeasured: u64) -> OutageSection {
        let longest = all
            .iter()
            .map(|(stage, ticks)| ((*stage).to_owned(), *ticks));
        OutageSection {
            longest: longest.collect(),
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
