//! When faults begin, and what counts as survived.

use campaign::gates::{Gates, METRICS};
use campaign::outcome::Outcome;
use model::role::Role;
use report::comparison::{SETTLING_S, STAYING_S};
use report::margin::{Gate, SATURATED, SATURATED_MORE_PERCENT, SMALLEST_BOUND_M, TIMES_UNFAULTED};

use crate::cli::margin::RECOVERED_BELOW;
use crate::cli::{GateLimit, MarginArgs};
use crate::margin::flights::Flown;
use crate::settings::Settings;
use crate::settings::laws::known;
use failure::{Failure, GATE};

/// Time until the error must be below the bound for good, where nobody says it [s].
const RECOVERY_MAX_S: f64 = 5.0;
/// Over how much of a trajectory that does not repeat faults begin [s].
const NO_CYCLE_S: f64 = 10.0;
/// How long a steady fault is flown, at least [s].
const STEADY_S: f64 = 10.0;

/// The metric of recovery.
const RECOVERY: &str = "recovery_max_s";

/// When faults begin.
#[derive(Clone, Debug, PartialEq)]
pub struct Phases {
    /// The first ticks of faults, in order.
    pub ticks: Vec<u64>,
    /// Over how much of the trajectory they are spread [s].
    pub span_s: f64,
    /// After which time it repeats [s].
    pub cycle_s: Option<f64>,
}

impl Phases {
    /// Those of a flight: from when the trajectory has left its ramp and the flight has settled, over one period.
    ///
    /// # Errors
    /// Usage: --duration leaves no room for them.
    pub fn new(args: &MarginArgs, settings: &Settings) -> Result<Self, Failure> {
        let course = settings.course()?;
        let (period_s, number) = (settings.flight.period_s, f64::from(args.phases));
        let first_s = course.begun_s() + SETTLING_S;
        let (cycle_s, rests_s) = (course.cycle_s(), course.end_s().map(|end_s| end_s - first_s));
        let whole_s = cycle_s.or(rests_s.filter(|left_s| *left_s > 0.0)).unwrap_or(NO_CYCLE_S);
        let span_s = match args.course.duration {
            Some(duration) => whole_s.min(duration.as_secs_f64() - first_s),
            None => whole_s,
        };
        if span_s < number * period_s {
            let duration_s = args.course.duration.unwrap_or_default().as_secs_f64();
            return Err(Failure::usage(format!(
                "--duration {duration_s}s is too short for {number} phases: faults begin at {first_s} s, when the \
                 trajectory has left its ramp and the flight has settled"
            ))
            .help("fly longer, or leave --duration out: faults then begin over one period of the trajectory"));
        }
        let tick = |i: u32| ((first_s + span_s * f64::from(i) / number) / period_s).round() as u64;
        Ok(Self { ticks: (0..args.phases).map(tick).collect(), span_s, cycle_s })
    }
}

/// What is asked of a flight, before anything is known of its laws.
#[derive(Clone, Debug)]
pub struct Asked {
    limits: Vec<GateLimit>,
}

impl Asked {
    /// The gates of the user.
    ///
    /// # Errors
    /// Usage: a gate is given twice.
    pub fn new(limits: &[GateLimit]) -> Result<Self, Failure> {
        if let Some((_, twice)) =
            limits.iter().enumerate().find(|(i, it)| limits[..*i].iter().any(|o| o.name == it.name))
        {
            return Err(Failure::usage(format!("--gate {} is given twice", twice.name)).help("give each limit once"));
        }
        Ok(Self { limits: limits.to_vec() })
    }

    fn limit(&self, name: &str) -> Option<f64> {
        self.limits.iter().find(|limit| limit.name == name).map(|limit| limit.most)
    }

    /// Time until the error must be below the bound for good [s].
    pub fn recovery_max_s(&self) -> f64 {
        self.limit(RECOVERY).unwrap_or(RECOVERY_MAX_S)
    }

    /// How long a flight goes on after an outage [s].
    pub fn after_s(&self) -> f64 {
        self.recovery_max_s() + STAYING_S
    }

    /// How long a steady fault is flown [s].
    pub fn steady_s(&self) -> f64 {
        STEADY_S.max(self.after_s())
    }

    /// As it is told.
    pub fn told(&self, settings: &Settings) -> Gate {
        let is_more = |limit: &&GateLimit| limit.name != RECOVERED_BELOW && limit.name != RECOVERY;
        Gate {
            recovered_below_m: self.limit(RECOVERED_BELOW),
            tracked_below_m: settings.flight.tracking_error_max_m,
            recovery_max_s: self.recovery_max_s(),
            limits: self.limits.iter().filter(is_more).map(|limit| (limit.name.into(), limit.most)).collect(),
        }
    }

    fn gates(&self, bound_m: f64, saturated: Option<f64>) -> Gates {
        let place = |name: &str| METRICS.iter().position(|metric| metric.name == name);
        let mut limits: Vec<(usize, f64)> =
            self.limits.iter().filter_map(|limit| Some((place(limit.name)?, limit.most))).collect();
        if self.limit(RECOVERY).is_none() {
            limits.extend(place(RECOVERY).map(|place| (place, RECOVERY_MAX_S)));
        }
        limits.extend(saturated.and_then(|most| Some((place(SATURATED)?, most))));
        Gates { limits, recovered_below_m: bound_m, telemetry: Vec::new() }
    }

    /// What it comes to for a flight that without a fault was this.
    pub fn judge(&self, unfaulted: Unfaulted, settings: &Settings) -> Judged {
        let bound_m = self.limit(RECOVERED_BELOW);
        let recovered_m = bound_m.unwrap_or((TIMES_UNFAULTED * unfaulted.error_m).max(SMALLEST_BOUND_M));
        let tracked_m = bound_m.unwrap_or(settings.flight.tracking_error_max_m.max(recovered_m));
        let own = self.limit(SATURATED);
        let saturated = unfaulted.saturated_percent + SATURATED_MORE_PERCENT;
        let judge = Judge {
            outage: self.gates(recovered_m, None),
            steady: self.gates(tracked_m, own.is_none().then_some(saturated)),
            saturated_max_percent: own.unwrap_or(saturated),
        };
        Judged { unfaulted, judge }
    }
}

/// How the flights of one seed are judged, and by what.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The flight without a fault.
    pub unfaulted: Unfaulted,
    /// What follows from it.
    pub judge: Judge,
}

/// What counts as survived with certain laws and one seed.
#[derive(Clone, Debug)]
pub struct Judge {
    /// After an outage.
    pub outage: Gates,
    /// Under a steady fault.
    pub steady: Gates,
    /// Under a steady fault, ticks that may be saturated [%].
    pub saturated_max_percent: f64,
}

/// A flight without a fault, from the first phase on.
#[derive(Clone, Debug)]
pub struct Unfaulted {
    /// Largest position error [m].
    pub error_m: f64,
    /// Ticks in which the rotors were saturated [%].
    pub saturated_percent: f64,
}

impl Unfaulted {
    /// What a flight without a fault came to.
    ///
    /// # Errors
    /// [`GATE`]: it was lost.
    pub fn of(flown: &Flown, name: &str) -> Result<Self, Failure> {
        if let Some(why) = &flown.outcome.lost {
            return Err(unflyable(name, why));
        }
        let metric = |name: &str| {
            let place = METRICS.iter().position(|metric| metric.name == name);
            place.and_then(|place| flown.outcome.metrics[place]).unwrap_or_default()
        };
        Ok(Self { error_m: metric("position_error_max_m"), saturated_percent: metric(SATURATED) })
    }
}

/// Refuses laws whose flight without a fault does not hold the gates.
///
/// # Errors
/// [`GATE`] names them with the gate.
pub fn check(name: &str, outcome: &Outcome, gates: &Gates) -> Result<(), Failure> {
    let held = gates.held(outcome);
    let failed = gates.limits.iter().zip(held).find(|(_, held)| *held == Some(false));
    let Some(((place, most), _)) = failed else { return Ok(()) };
    let metric = METRICS[*place];
    let found = match outcome.metrics[*place] {
        Some(found) => format!("{found} {}", metric.unit),
        None => format!("the position error does not stay below {} m", gates.recovered_below_m),
    };
    Err(unflyable(name, &format!("{}: {}, allowed are {most}", metric.name, found.trim_end())))
}

fn unflyable(name: &str, why: &str) -> Failure {
    Failure::new(GATE, format!("{name} does not hold the gate without a fault: {why}"))
        .help("choose laws, a trajectory or a preset that fly, or another gate, as in --gate recovered_below_m=0.2")
}

/// Laws in a word.
pub fn name(settings: &Settings) -> Result<String, Failure> {
    let [outer, inner, mixer] = settings.laws()?.map(|law| law.name);
    Ok(if mixer == known(Role::Mixer)[0].name {
        format!("{outer} + {inner}")
    } else {
        format!("{outer} + {inner} + {mixer}")
    })
}
