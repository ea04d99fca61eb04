//! Changes of airframe parameters in flight, as the report lists them.

use messages::content::{Change, SwapRecord};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedSwap {
    pub tick: u64,
    pub time_s: f64,
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
        let change = |it: Change| ParameterChange {
            name: it.parameter.name().into(),
            old: it.old,
            new: it.new,
            over_s: if it.steps > 1 {
                it.steps as f64 * period_s
            } else {
                0.0
            },
        };
        Self {
            tick,
            time_s: tick as f64 * period_s,
            parameter_epoch: record.parameter_epoch,
            changes: record.changes().map(change).collect(),
        }
    }

    /// What changed: `mass_kg 0.52 -> 0.676`, and of a ramp also `over 2 s from tick 8000`.
    pub fn words(&self) -> String {
        let words = |it: &ParameterChange| {
            let change = format!("{} {} -> {}", it.name, it.old, it.new);
            match it.over_s {
                0.0 => change,
                over_s => format!("{change} over {} from tick {}", seconds(over_s), self.tick),
            }
        };
        let words: Vec<String> = self.changes.iter().map(words).collect();
        words.join(", ")
    }
}

/// The length of a ramp: whole microseconds, as a sum of ticks is not.
pub(crate) fn seconds(over_s: f64) -> String {
    format!("{} s", (over_s * 1e6).round() / 1e6)
}
