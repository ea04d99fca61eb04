//! Changes of airframe parameters in flight, as the report lists them.

use messages::content::{Change, SwapRecord};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedSwap {
    pub tick: u64,
    /// The same as time of the flight [s].
    pub time_s: f64,
    /// Parameter epoch that began with it.
    pub parameter_epoch: u64,
    pub changes: Vec<ParameterChange>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterChange {
    pub name: String,
    pub old: f64,
    /// From then on, or from the end of the ramp on.
    pub new: f64,
    /// How long the ramp to it takes [s]; 0 where it holds at once.
    #[serde(default)]
    pub over_s: f64,
}

impl AppliedSwap {
    /// A swap that holds from a tick of `period_s` [s] on.
    pub fn new(tick: u64, period_s: f64, record: &SwapRecord) -> Self {
        Self {
            tick,
            time_s: tick as f64 * period_s,
            parameter_epoch: record.parameter_epoch,
            changes: record
                .changes()
                .map(
                    |Change {
                         parameter,
                         old,
                         new,
                         steps,
                     }| {
                        let over_s = if steps > 1 {
                            steps as f64 * period_s
                        } else {
                            0.0
                        };
                        ParameterChange {
                            name: parameter.name().into(),
                            old,
                            new,
                            over_s,
                        }
                    },
                )
                .collect(),
        }
    }

    /// What changed: `mass_kg 0.52 -> 0.676`, and of a ramp also `over 2 s from tick 8000`.
    pub fn words(&self) -> String {
        let words = |change: &ParameterChange| {
            let ParameterChange {
                name,
                old,
                new,
                over_s,
            } = change;
            let over = if *over_s > 0.0 {
                format!(" over {} from tick {}", seconds(*over_s), self.tick)
            } else {
                String::new()
            };
            format!("{name} {old} -> {new}{over}")
        };
        self.changes
            .iter()
            .map(words)
            .collect::<Vec<_>>()
            .join(", ")
    }
}

/// The length of a ramp: whole microseconds, as a sum of ticks is not.
pub(crate) fn seconds(over_s: f64) -> String {
    format!("{} s", (over_s * 1e6).round() / 1e6)
}
