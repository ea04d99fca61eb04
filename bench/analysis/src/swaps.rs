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
}
