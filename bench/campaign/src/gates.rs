//! What counts as success: limits of metrics, ranges of laws' own numbers.

use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::role::Role;

pub const RECOVERED_BELOW_M: f64 = 0.05;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    pub name: &'static str,
    pub unit: &'static str,
    pub meaning: &'static str,
}

const fn metric(name: &'static str, unit: &'static str, meaning: &'static str) -> Metric {
    Metric {
        name,
        unit,
        meaning,
    }
}

/// The metrics of every flight, in the order of [`crate::metrics::Metrics::values`].
pub const METRICS: [Metric; 9] = [
    metric("flown_s", "s", "time flown"),
    metric("position_error_max_m", "m", "largest true position error"),
    metric(
        "position_error_rms_m",
        "m",
        "true position error, root mean square",
    ),
    metric(
        "tracking_error_max_m",
        "m",
        "largest true position error of the last 5 s",
    ),
    metric(
        "recovery_max_s",
        "s",
        "longest time from a fault until the error was below recovered_below_m and stayed",
    ),
    metric(
        "tilt_max_rad",
        "rad",
        "largest angle between body z and the vertical",
    ),
    metric(
        "saturated_percent",
        "%",
        "ticks in which the mixer could not give what was asked",
    ),
    metric(
        "power",
        "",
        "mean rotor power, sum of cubed speeds, as a multiple of hover",
    ),
    metric(
        "agitation_rad_s",
        "rad/s",
        "change of a rotor's command in a tick, root mean square",
    ),
];

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gates {
    /// Places of metrics, and the most that each may be.
    pub limits: Vec<(usize, f64)>,
    /// True position error below which a flight has recovered from a fault [m].
    pub recovered_below_m: f64,
    pub telemetry: Vec<SignalGate>,
}

/// A number that a law shows, and what it must stay within in every tick in which it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalGate {
    pub role: Role,
    pub signal: String,
    pub range: [f64; 2],
}

impl SignalGate {
    pub fn name(&self) -> String {
        format!("{}.{}", self.role, self.signal)
    }

    /// The number at a place of the law's telemetry; none where its stage gave nothing or does not know it.
    pub fn value(
        &self,
        place: usize,
        setpoint: Option<&Setpoint>,
        wrench: &Wrench,
        rotors: &RotorSpeeds,
    ) -> Option<f64> {
        let telemetry = match self.role {
            Role::Outer => &setpoint?.telemetry,
            Role::Mixer => &rotors.telemetry,
            _ => &wrench.telemetry,
        };
        Some(telemetry.value[place]).filter(|value| !value.is_nan())
    }
}

impl Gates {
    pub fn names(&self) -> impl Iterator<Item = String> + '_ {
        let limits = self.limits.iter();
        let limits = limits.map(|(place, _)| METRICS[*place].name.to_owned());
        limits.chain(self.telemetry.iter().map(SignalGate::name))
    }
}
