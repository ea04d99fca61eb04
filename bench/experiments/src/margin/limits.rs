//! When faults begin, and what counts as survived.

use std::time::Duration;

use analysis::comparison::{SETTLING_S, STAYING_S};
use analysis::margin::{
    Gate, SATURATED, SATURATED_MORE_PERCENT, SMALLEST_BOUND_M, TIMES_UNFAULTED,
};
use campaign::gates::{Gates, METRICS, Outcome};

use config::Settings;
use errors::{Failure, GATE};

/// Default time within which the flight must have recovered [s].
const RECOVERY_MAX_S: f64 = 5.0;
/// For a trajectory that does not repeat: the span in which faults begin [s].
const NO_CYCLE_S: f64 = 10.0;
/// Minimum length of a flight under a steady fault [s].
const STEADY_S: f64 = 10.0;

const RECOVERY: &str = "recovery_max_s";

/// A limit that a flight must hold to count as survived.
#[derive(Clone, Debug, PartialEq)]
pub struct GateLimit {
    /// A metric of a campaign's `[success]`.
    pub name: &'static str,
    pub most: f64,
}

/// The bound below which a flight has recovered: a parameter of a metric, not a metric.
pub const RECOVERED_BELOW: &str = "recovered_below_m";

#[derive(Clone, Debug, PartialEq)]
pub struct Phases {
    /// First ticks of the faults, ascending; at least one.
    pub ticks: Vec<u64>,
    /// Span of the trajectory that they cover [s].
    pub span_s: f64,
    /// Period of the trajectory [s].
    pub cycle_s: Option<f64>,
}

impl Phases {
    /// From the end of the trajectory's ramp and of the flight's settling time, over one period.
    pub fn new(
        phases: u32,
        duration: Option<Duration>,
        settings: &Settings,
    ) -> Result<Self, Failure> {
        let course = settings.course()?;
        let (period_s, number) = (settings.flight.period_s, f64::from(phases));
        let first_s = course.begun_s() + SETTLING_S;
        let rest_s = course.end_s().map(|end_s| end_s - first_s);
        let cycle_s = course.cycle_s();
        let whole_s = cycle_s.or(rest_s.filter(|rest_s| *rest_s > 0.0));
        let mut span_s = whole_s.unwrap_or(NO_CYCLE_S);
        let duration_s = duration.map(|duration| duration.as_secs_f64());
        if let Some(duration_s) = duration_s {
            span_s = span_s.min(duration_s - first_s);
        }
        if span_s < number * period_s {
            let duration_s = duration_s.unwrap_or_default();
            return Err(Failure::usage(format!(
                "--duration {duration_s}s is too short for {number} phases: faults begin at {first_s} s, after the \
                 trajectory's ramp and the settling time"
            ))
            .help("fly longer, or leave --duration out to cover one period of the trajectory"));
        }
        let tick = |i: u32| ((first_s + span_s * f64::from(i) / number) / period_s).round() as u64;
        Ok(Self {
            ticks: (0..phases).map(tick).collect(),
            span_s,
            cycle_s,
        })
    }
}

/// The limits given on the command line.
#[derive(Clone, Debug)]
pub struct GivenLimits(Vec<GateLimit>);

/// Limits for certain laws and one seed, and the flight without a fault that they follow from.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Largest position error without a fault, from the first phase on [m].
    pub unfaulted_error_m: f64,
    /// Ticks without a fault in which the rotors were saturated [%].
    pub unfaulted_saturated_percent: f64,
    pub outage: Gates,
    pub steady: Gates,
    /// Largest share of saturated ticks under a steady fault [%].
    pub saturated_max_percent: f64,
}

impl GivenLimits {
    pub fn new(limits: &[GateLimit]) -> Result<Self, Failure> {
        for (i, limit) in limits.iter().enumerate() {
            if limits[..i].iter().any(|other| other.name == limit.name) {
                let what = format!("--gate {} is given twice", limit.name);
                return Err(Failure::usage(what).help("give each limit once"));
            }
        }
        Ok(Self(limits.to_vec()))
    }

    fn limit(&self, name: &str) -> Option<f64> {
        let limit = self.0.iter().find(|limit| limit.name == name);
        limit.map(|limit| limit.most)
    }

    /// Time within which the flight must have recovered [s].
    fn recovery_max_s(&self) -> f64 {
        self.limit(RECOVERY).unwrap_or(RECOVERY_MAX_S)
    }

    /// Flight time after an outage [s].
    pub fn after_s(&self) -> f64 {
        self.recovery_max_s() + STAYING_S
    }

    /// Length of a flight under a steady fault [s].
    pub fn steady_s(&self) -> f64 {
        STEADY_S.max(self.after_s())
    }

    pub fn gate(&self, settings: &Settings) -> Gate {
        let is_other = |limit: &&GateLimit| ![RECOVERED_BELOW, RECOVERY].contains(&limit.name);
        let others = self.0.iter().filter(is_other);
        Gate {
            recovered_below_m: self.limit(RECOVERED_BELOW),
            tracked_below_m: settings.flight.tracking_error_max_m,
            recovery_max_s: self.recovery_max_s(),
            limits: others.map(|it| (it.name.into(), it.most)).collect(),
        }
    }

    /// All limits: those that are given, then the defaults.
    fn gates(&self, bound_m: f64, saturated: Option<f64>) -> Gates {
        let given = self.0.iter().map(|limit| (limit.name, limit.most));
        let recovery = self.limit(RECOVERY).is_none();
        let recovery = recovery.then_some((RECOVERY, RECOVERY_MAX_S));
        let saturated = saturated.map(|most| (SATURATED, most));
        let limits = given.chain(recovery).chain(saturated);
        Gates {
            limits: limits
                .filter_map(|(name, most)| Some((place(name)?, most)))
                .collect(),
            recovered_below_m: bound_m,
            telemetry: Vec::new(),
        }
    }

    /// The limits for laws that fly like this without a fault.
    pub fn judge(
        &self,
        unfaulted: &Outcome,
        name: &str,
        settings: &Settings,
    ) -> Result<Judged, Failure> {
        if let Some(why) = &unfaulted.lost {
            return Err(unflyable(name, why));
        }
        let error_m = metric(unfaulted, "position_error_max_m").unwrap_or_default();
        let saturated_percent = metric(unfaulted, SATURATED).unwrap_or_default();
        let bound_m = self.limit(RECOVERED_BELOW);
        let recovered_m = bound_m.unwrap_or((TIMES_UNFAULTED * error_m).max(SMALLEST_BOUND_M));
        let tracked_m = bound_m.unwrap_or(settings.flight.tracking_error_max_m.max(recovered_m));
        let given = self.limit(SATURATED);
        let saturated = saturated_percent + SATURATED_MORE_PERCENT;
        Ok(Judged {
            unfaulted_error_m: error_m,
            unfaulted_saturated_percent: saturated_percent,
            outage: self.gates(recovered_m, None),
            steady: self.gates(tracked_m, given.is_none().then_some(saturated)),
            saturated_max_percent: given.unwrap_or(saturated),
        })
    }
}

fn place(name: &str) -> Option<usize> {
    METRICS.iter().position(|metric| metric.name == name)
}

pub fn metric(outcome: &Outcome, name: &str) -> Option<f64> {
    outcome.metrics[place(name)?]
}

/// Refuses laws that miss the limits even without a fault.
pub fn check(name: &str, outcome: &Outcome, gates: &Gates) -> Result<(), Failure> {
    let mut held = gates.limits.iter().zip(gates.held(outcome));
    let Some(((place, most), _)) = held.find(|(_, held)| *held == Some(false)) else {
        return Ok(());
    };
    let metric = METRICS[*place];
    let bound_m = gates.recovered_below_m;
    let value = outcome.metrics[*place].map_or_else(
        || format!("the position error does not stay below {bound_m} m"),
        |value| format!("{value} {}", metric.unit),
    );
    let why = format!("{}: {}, allowed are {most}", metric.name, value.trim_end());
    Err(unflyable(name, &why))
}

fn unflyable(name: &str, why: &str) -> Failure {
    Failure::new(GATE, format!("{name} does not hold the gate without a fault: {why}"))
        .help("choose other laws, another trajectory or preset, or a wider limit such as --gate recovered_below_m=0.2")
}
