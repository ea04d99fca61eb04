//! The outcome of a flight, and what counts as success: limits of metrics, ranges of the laws' signals.

use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::role::Role;

pub const RECOVERED_BELOW_M: f64 = 0.05;
/// Metrics of the last 5 s: a limit for the first one implies [`YAW_ERROR_MAX_RAD`] for the second.
pub const TRACKING_ERROR: &str = "tracking_error_max_m";
pub const TRACKING_YAW_ERROR: &str = "tracking_yaw_error_max_rad";
/// Largest yaw error of the last 5 s in a flight that succeeds, and of one that has recovered, if a campaign sets none
/// [rad].
pub const YAW_ERROR_MAX_RAD: f64 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    pub name: &'static str,
    pub unit: &'static str,
    pub meaning: &'static str,
}

/// The metric that only a flight with faults has.
const RECOVERY: &str = "recovery_max_s";

const fn metric(name: &'static str, unit: &'static str, meaning: &'static str) -> Metric {
    Metric {
        name,
        unit,
        meaning,
    }
}

/// The metrics of every flight, in the order of [`crate::metrics::Metrics::values`].
pub const METRICS: [Metric; 14] = [
    metric("flown_s", "s", "time flown"),
    metric("position_error_max_m", "m", "largest true position error"),
    metric(
        "position_error_rms_m",
        "m",
        "true position error, root mean square",
    ),
    metric(
        TRACKING_ERROR,
        "m",
        "largest true position error of the last 5 s",
    ),
    metric(
        RECOVERY,
        "s",
        "longest time from a fault until the errors stayed below recovered_below_m and recovered_yaw_below_rad",
    ),
    metric(
        "tilt_max_rad",
        "rad",
        "largest angle between body z and the vertical",
    ),
    metric(
        "saturated_percent",
        "%",
        "ticks in which the mixer could not give what was requested",
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
    metric("yaw_error_max_rad", "rad", "largest true yaw error"),
    metric(
        "yaw_error_rms_rad",
        "rad",
        "true yaw error, root mean square",
    ),
    metric(
        TRACKING_YAW_ERROR,
        "rad",
        "largest true yaw error of the last 5 s",
    ),
    metric(
        "tilt_error_max_rad",
        "rad",
        "largest angle between body z and the thrust that the reference needs",
    ),
    metric(
        "tilt_error_rms_rad",
        "rad",
        "the same angle, root mean square",
    ),
];

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gates {
    /// Places of metrics, and the most that each may be.
    pub limits: Vec<(usize, f64)>,
    /// True errors of position [m] and yaw [rad] below which a flight has recovered from a fault.
    pub recovered_below_m: f64,
    pub recovered_yaw_below_rad: f64,
    pub telemetry: Vec<SignalGate>,
}

/// A signal of a law, and the range that it must stay in whenever it is set.
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

    /// The signal at a place of the law's telemetry; none if its stage published nothing or did not set it.
    pub fn value(
        &self,
        place: usize,
        setpoint: Option<&Setpoint>,
        wrench: Option<&Wrench>,
        rotors: Option<&RotorSpeeds>,
    ) -> Option<f64> {
        let telemetry = match self.role {
            Role::Outer => &setpoint?.telemetry,
            Role::Mixer => &rotors?.telemetry,
            _ => &wrench?.telemetry,
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

#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the flight had faults from which it could recover.
    pub is_faulted: bool,
    pub lost: Option<String>,
    pub metrics: [Option<f64>; METRICS.len()],
    /// Smallest and largest value of each signal with a gate, [`UNSET`] if it was never set; none if the flight's laws
    /// have no such signal.
    pub telemetry: Vec<Option<[f64; 2]>>,
    /// Hash over all outputs, as `simulate` prints it.
    pub outputs: String,
}

/// The range of a signal that was never set.
pub const UNSET: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

impl Gates {
    /// Which gates held, in the order of [`Gates::names`]; none of those that are not of this flight's laws, or of the
    /// recovery from faults that it did not have. A gate that measured nothing did not hold.
    pub fn held(&self, outcome: &Outcome) -> Vec<Option<bool>> {
        let within = |(place, most): &(usize, f64)| {
            let is_asked = outcome.is_faulted || METRICS[*place].name != RECOVERY;
            is_asked.then(|| outcome.metrics[*place].is_some_and(|value| value <= *most))
        };
        let limits = self.limits.iter().map(within);
        let gates = self.telemetry.iter().zip(&outcome.telemetry);
        let telemetry = gates.map(|(gate, range)| {
            let [low, high] = (*range)?;
            Some(low <= high && gate.range[0] <= low && high <= gate.range[1])
        });
        limits.chain(telemetry).collect()
    }

    /// Whether a flight was flown to its end, within its envelope, and every gate held.
    pub fn is_success(&self, outcome: &Outcome) -> bool {
        outcome.lost.is_none() && !self.held(outcome).contains(&Some(false))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn success_is_a_whole_flight_in_which_every_gate_held() {
        let gate = SignalGate {
            role: Role::Inner,
            signal: "k".into(),
            range: [-1.0, 1.0],
        };
        let gates = Gates {
            limits: vec![(1, 0.5), (4, 2.0)],
            recovered_below_m: 0.05,
            recovered_yaw_below_rad: 0.1,
            telemetry: vec![gate],
        };
        let metrics = [Some(0.1); METRICS.len()];
        let flown = |metrics, range, lost: Option<&str>| Outcome {
            is_faulted: true,
            lost: lost.map(str::to_owned),
            metrics,
            telemetry: vec![range],
            outputs: String::new(),
        };
        let recovered = |time_s: Option<f64>| {
            let mut metrics = metrics;
            metrics[4] = time_s;
            metrics
        };
        let inside = Some([-1.0, 0.5]);
        for (expected, metrics, range, lost) in [
            (true, metrics, inside, None),
            (true, metrics, None, None),
            // A lost flight is no success, whatever it measured.
            (false, metrics, inside, Some("lost")),
            // A gate that measured nothing did not hold.
            (false, metrics, Some(UNSET), None),
            (false, metrics, Some([-1.0, 1.5]), None),
            (false, recovered(None), inside, None),
        ] {
            let is_success = gates.is_success(&flown(metrics, range, lost));
            assert_eq!(is_success, expected, "{range:?} {lost:?}");
        }
        let mut metrics = recovered(Some(2.0));
        metrics[1] = Some(0.51);
        let flown = flown(metrics, inside, None);
        let held = [Some(false), Some(true), Some(true)];
        assert_eq!(gates.held(&flown), held);
        // Without a fault there is nothing to recover from.
        let unfaulted = Outcome {
            is_faulted: false,
            ..flown
        };
        assert_eq!(gates.held(&unfaulted), [Some(false), None, Some(true)]);
    }
}
