//! When faults begin, and what counts as survived.

use campaign::gates::{Gates, METRICS};
use campaign::outcome::Outcome;
use messages::role::Role;
use report::comparison::{SETTLING_S, STAYING_S};
use report::margin::{Gate, SATURATED, SATURATED_MORE_PERCENT, SMALLEST_BOUND_M, TIMES_UNFAULTED};

use crate::cli::RECOVERED_BELOW;
use crate::cli::{GateLimit, MarginArgs};
use crate::margin::flights::Flown;
use crate::settings::Settings;
use crate::settings::law_settings::known;
use errors::{Failure, GATE};

/// Default time within which the flight must have recovered [s].
const RECOVERY_MAX_S: f64 = 5.0;
/// For a trajectory that does not repeat: the span in which faults begin [s].
const NO_CYCLE_S: f64 = 10.0;
/// Minimum length of a flight under a steady fault [s].
const STEADY_S: f64 = 10.0;

const RECOVERY: &str = "recovery_max_s";

#[derive(Clone, Debug, PartialEq)]
pub struct Phases {
    /// First ticks of the faults, ascending.
    pub ticks: Vec<u64>,
    /// Span of the trajectory that they cover [s].
    pub span_s: f64,
    /// Period of the trajectory [s].
    pub cycle_s: Option<f64>,
}

impl Phases {
    /// From the end of the trajectory's ramp and of the flight's settling time, over one period.
    pub fn new(args: &MarginArgs, settings: &Settings) -> Result<Self, Failure> {
        let course = settings.course()?;
        let (period_s, number) = (settings.flight.period_s, f64::from(args.phases));
        let first_s = course.begun_s() + SETTLING_S;
        let (cycle_s, rests_s) = (
            course.cycle_s(),
            course.end_s().map(|end_s| end_s - first_s),
        );
        let whole_s = cycle_s
            .or(rests_s.filter(|left_s| *left_s > 0.0))
            .unwrap_or(NO_CYCLE_S);
        let span_s = match args.course.duration {
            Some(duration) => whole_s.min(duration.as_secs_f64() - first_s),
            None => whole_s,
        };
        if span_s < number * period_s {
            let duration_s = args.course.duration.unwrap_or_default().as_secs_f64();
            return Err(Failure::usage(format!(
                "--duration {duration_s}s is too short for {number} phases: faults begin at {first_s} s, after the \
                 trajectory's ramp and the settling time"
            ))
            .help("fly longer, or leave --duration out to cover one period of the trajectory"));
        }
        let tick = |i: u32| ((first_s + span_s * f64::from(i) / number) / period_s).round() as u64;
        Ok(Self {
            ticks: (0..args.phases).map(tick).collect(),
            span_s,
            cycle_s,
        })
    }
}

/// The limits given on the command line.
#[derive(Clone, Debug)]
pub struct Asked {
    limits: Vec<GateLimit>,
}

impl Asked {
    pub fn new(limits: &[GateLimit]) -> Result<Self, Failure> {
        if let Some((_, twice)) = limits
            .iter()
            .enumerate()
            .find(|(i, it)| limits[..*i].iter().any(|o| o.name == it.name))
        {
            return Err(
                Failure::usage(format!("--gate {} is given twice", twice.name))
                    .help("give each limit once"),
            );
        }
        Ok(Self {
            limits: limits.to_vec(),
        })
    }

    fn limit(&self, name: &str) -> Option<f64> {
        self.limits
            .iter()
            .find(|limit| limit.name == name)
            .map(|limit| limit.most)
    }

    /// Time within which the flight must have recovered [s].
    pub fn recovery_max_s(&self) -> f64 {
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
        let is_more = |limit: &&GateLimit| limit.name != RECOVERED_BELOW && limit.name != RECOVERY;
        Gate {
            recovered_below_m: self.limit(RECOVERED_BELOW),
            tracked_below_m: settings.flight.tracking_error_max_m,
            recovery_max_s: self.recovery_max_s(),
            limits: self
                .limits
                .iter()
                .filter(is_more)
                .map(|limit| (limit.name.into(), limit.most))
                .collect(),
        }
    }

    fn gates(&self, bound_m: f64, saturated: Option<f64>) -> Gates {
        let place = |name: &str| METRICS.iter().position(|metric| metric.name == name);
        let mut limits: Vec<(usize, f64)> = self
            .limits
            .iter()
            .filter_map(|limit| Some((place(limit.name)?, limit.most)))
            .collect();
        if self.limit(RECOVERY).is_none() {
            limits.extend(place(RECOVERY).map(|place| (place, RECOVERY_MAX_S)));
        }
        limits.extend(saturated.and_then(|most| Some((place(SATURATED)?, most))));
        Gates {
            limits,
            recovered_below_m: bound_m,
            telemetry: Vec::new(),
        }
    }

    /// The limits for laws that fly like this without a fault.
    pub fn judge(&self, unfaulted: Unfaulted, settings: &Settings) -> Judged {
        let bound_m = self.limit(RECOVERED_BELOW);
        let recovered_m =
            bound_m.unwrap_or((TIMES_UNFAULTED * unfaulted.error_m).max(SMALLEST_BOUND_M));
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

/// The flight without a fault of one seed, and the limits that follow.
#[derive(Clone, Debug)]
pub struct Judged {
    pub unfaulted: Unfaulted,
    pub judge: Judge,
}

/// Limits for certain laws and one seed.
#[derive(Clone, Debug)]
pub struct Judge {
    pub outage: Gates,
    pub steady: Gates,
    /// Largest share of saturated ticks under a steady fault [%].
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
    pub fn of(flown: &Flown, name: &str) -> Result<Self, Failure> {
        if let Some(why) = &flown.outcome.lost {
            return Err(unflyable(name, why));
        }
        let metric = |name: &str| {
            let place = METRICS.iter().position(|metric| metric.name == name);
            place
                .and_then(|place| flown.outcome.metrics[place])
                .unwrap_or_default()
        };
        Ok(Self {
            error_m: metric("position_error_max_m"),
            saturated_percent: metric(SATURATED),
        })
    }
}

/// Refuses laws that miss the limits even without a fault.
pub fn check(name: &str, outcome: &Outcome, gates: &Gates) -> Result<(), Failure> {
    let held = gates.held(outcome);
    let failed = gates
        .limits
        .iter()
        .zip(held)
        .find(|(_, held)| *held == Some(false));
    let Some(((place, most), _)) = failed else {
        return Ok(());
    };
    let metric = METRICS[*place];
    let found = match outcome.metrics[*place] {
        Some(found) => format!("{found} {}", metric.unit),
        None => format!(
            "the position error does not stay below {} m",
            gates.recovered_below_m
        ),
    };
    Err(unflyable(
        name,
        &format!("{}: {}, allowed are {most}", metric.name, found.trim_end()),
    ))
}

fn unflyable(name: &str, why: &str) -> Failure {
    Failure::new(GATE, format!("{name} does not hold the gate without a fault: {why}"))
        .help("choose other laws, another trajectory or preset, or a wider limit such as --gate recovered_below_m=0.2")
}

pub fn name(settings: &Settings) -> Result<String, Failure> {
    let [outer, inner, mixer] = settings.laws()?.map(|law| law.name);
    Ok(if mixer == known(Role::Mixer)[0].name {
        format!("{outer} + {inner}")
    } else {
        format!("{outer} + {inner} + {mixer}")
    })
}
