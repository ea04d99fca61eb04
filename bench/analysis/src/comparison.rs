//! One flight by several combinations of laws, side by side.
//!
//! [`crate::flight_metrics`] measures each flight; the crate `render` shows the outcomes.

use crate::schema::AngleErrors;
use crate::traces::{Group, Traces};
use flight_log::build::Build;
use serde::{Deserialize, Serialize};

pub const SCHEMA: &str = "ironbird-comparison/1";
/// How long after a fault a flight has to settle before its error counts as lasting [s].
pub const SETTLING_S: f64 = 5.0;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub schema: &'static str,
    pub build: Build,
    pub flight: Flight,
    /// In the order in which the laws were named.
    pub outcomes: Vec<Outcome>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Flight {
    pub trajectory: String,
    pub airframe: String,
    /// Preset of the laws that have one of that name.
    pub preset: String,
    pub seed: u64,
    /// Last tick of the plan; the first one is 0.
    pub last_tick: u64,
    pub period_s: f64,
    /// A flight has recovered when its true position error stays below this [m], and its true yaw error below that [rad].
    pub bound_m: f64,
    pub bound_yaw_rad: f64,
    /// Instants at which something was made to go wrong, in order.
    pub faults: Vec<Fault>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fault {
    pub tick: u64,
    pub time_s: f64,
    pub what: String,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Laws {
    pub outer: String,
    pub inner: String,
    pub mixer: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    pub laws: Laws,
    /// Preset that it flew: not that of the flight, if none of its laws has that one.
    pub preset: String,
    pub ticks: u64,
    /// Instant at which the flight ended before its time [s].
    pub ended_early_s: Option<f64>,
    /// Why the flight counts as lost, if it does; one that was below ground is flown on.
    pub lost: Option<String>,
    /// Instant of the loss [s]: the figures end there.
    pub lost_s: Option<f64>,
    /// A sentence for each law whose answers could not all be used.
    pub unusable: Vec<String>,
    /// The traces that a page draws; JSON has them only on request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<Traces>,
    #[serde(flatten)]
    pub figures: Figures,
    /// Hash over all outputs, as `simulate` prints it.
    pub outputs: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    pub error: ErrorFigures,
    /// The same before the first fault; none where a fault begins at tick 0, or there is none.
    pub error_before: Option<ErrorFigures>,
    /// The same from the first fault on.
    pub error_from_fault: Option<ErrorFigures>,
    /// The same from [`SETTLING_S`] after the last fault on; none where the flight was over by then, or there is none.
    pub error_after: Option<ErrorFigures>,
    /// Errors of the whole flight; none without a state.
    pub yaw_error: Option<AngleErrors>,
    pub tilt_error: Option<AngleErrors>,
    /// Per fault, time until the true errors of position and yaw stayed below their bounds ([`crate::recovery`]) [s]; none where they did
    /// not.
    pub recovery_s: Vec<Option<f64>>,
    pub effort: Effort,
    /// The curves of a page; JSON has them only on request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trace: Option<Group>,
}

impl Figures {
    /// The longest recovery from a fault [s]; none without a fault, and where there was no recovery from one.
    pub fn longest_recovery_s(&self) -> Option<f64> {
        let each: Option<Vec<f64>> = self.recovery_s.iter().copied().collect();
        each?.into_iter().max_by(f64::total_cmp)
    }
}

/// Channel of the trace: distance of the true position from the reference [m].
pub const TRUE_ERROR: &str = "true_position_error_m";
/// Channel of the trace: sum of the cubed rotor speeds, as a multiple of that in hover.
pub const POWER: &str = "rotor_power";

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ErrorFigures {
    pub rms_m: f64,
    pub p99_m: f64,
    pub worst_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Effort {
    /// Mean of the sum of the cubed speeds, which the power of a rotor goes with, as a multiple of that in hover.
    pub power: f64,
    /// Root mean square of the change of a rotor's command from tick to tick [rad/s].
    pub agitation_rad_s: f64,
    /// Share of the ticks in which the mixer could not deliver the demand [%].
    pub saturated_percent: f64,
}

impl Comparison {
    pub fn mixers_differ(&self) -> bool {
        Laws::mixers_differ(self.outcomes.iter().map(|outcome| &outcome.laws))
    }

    /// The name of a combination among these: `pd + adaptive`.
    pub fn name_of(&self, laws: &Laws) -> String {
        laws.name(self.mixers_differ())
    }
}

impl Laws {
    /// Whether combinations differ in their mixers: else its name says nothing.
    pub fn mixers_differ<'a>(mut all: impl Iterator<Item = &'a Self>) -> bool {
        let first = all.next();
        all.any(|laws| first.is_some_and(|first| first.mixer != laws.mixer))
    }

    /// `pd + adaptive`, and the mixer where it is requested.
    pub fn name(&self, with_mixer: bool) -> String {
        let name = format!("{} + {}", self.outer, self.inner);
        match with_mixer {
            true => format!("{name} + {}", self.mixer),
            false => name,
        }
    }
}

impl Flight {
    /// From when on an error counts as lasting [ticks]; none without a fault.
    pub fn settled_tick(&self) -> Option<u64> {
        let settling = (SETTLING_S / self.period_s).round() as u64;
        self.faults.last().map(|fault| fault.tick + settling)
    }

    pub fn time_s(&self, tick: u64) -> f64 {
        tick as f64 * self.period_s
    }
}
