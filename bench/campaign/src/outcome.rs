//! What came of a flight, and whether that counts as success.

use crate::gates::{Gates, METRICS};

#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Why the flight counts as lost, if it does.
    pub lost: Option<String>,
    /// As [`METRICS`].
    pub metrics: [Option<f64>; METRICS.len()],
    /// What the laws showed, by the gates on it.
    pub telemetry: Vec<Shown>,
    /// Hash over all outputs, as `simulate` prints it.
    pub outputs: String,
}

/// What a law showed of a number in a flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shown {
    /// The law has no such number.
    NotOfThisLaw,
    /// It has, and never knew it.
    Never,
    Between([f64; 2]),
}

impl Shown {
    /// With one more value of it.
    pub fn and(self, value: f64) -> Self {
        match self {
            Self::Between([low, high]) => Self::Between([low.min(value), high.max(value)]),
            _ => Self::Between([value, value]),
        }
    }

    /// The smallest and the largest, where there were some.
    pub const fn range(self) -> Option<[f64; 2]> {
        match self {
            Self::Between(range) => Some(range),
            _ => None,
        }
    }
}

impl Gates {
    /// Which gates held, in the order of [`Gates::names`]; none of those that are not of this flight's laws. A gate
    /// that measured nothing did not hold.
    pub fn held(&self, outcome: &Outcome) -> Vec<Option<bool>> {
        let limits = self
            .limits
            .iter()
            .map(|(place, most)| Some(outcome.metrics[*place].is_some_and(|it| it <= *most)));
        let telemetry = self
            .telemetry
            .iter()
            .zip(&outcome.telemetry)
            .map(|(gate, shown)| match shown {
                Shown::NotOfThisLaw => None,
                Shown::Never => Some(false),
                Shown::Between([low, high]) => {
                    Some(gate.range[0] <= *low && *high <= gate.range[1])
                }
            });
        limits.chain(telemetry).collect()
    }

    /// Whether a flight was flown to its end, within its envelope, and every gate held.
    pub fn is_success(&self, outcome: &Outcome) -> bool {
        outcome.lost.is_none()
            && self
                .held(outcome)
                .into_iter()
                .all(|held| held != Some(false))
    }
}

#[cfg(test)]
mod tests {
    use messages::role::Role;

    use super::*;
    use crate::gates::SignalGate;

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
            telemetry: vec![gate],
        };
        let mut metrics = [Some(0.1); METRICS.len()];
        let flown = |metrics, shown, lost: Option<&str>| Outcome {
            lost: lost.map(str::to_owned),
            metrics,
            telemetry: vec![shown],
            outputs: String::new(),
        };
        let inside = Shown::Never.and(-1.0).and(0.5);
        let success = |metrics, shown, lost| gates.is_success(&flown(metrics, shown, lost));
        assert!(success(metrics, inside, None) && success(metrics, Shown::NotOfThisLaw, None));
        assert!(
            !success(metrics, inside, Some("lost")),
            "a lost flight is no success, whatever it measured"
        );
        assert!(
            !success(metrics, Shown::Never, None),
            "a gate that measured nothing did not hold"
        );
        assert!(!success(metrics, inside.and(1.5), None));
        metrics[4] = None;
        assert!(
            !success(metrics, inside, None),
            "who did not recover did not recover in time"
        );
        metrics[4] = Some(2.0);
        metrics[1] = Some(0.51);
        assert_eq!(
            gates.held(&flown(metrics, inside, None)),
            [Some(false), Some(true), Some(true)]
        );
    }
}
