//! The baseline of the machine, measured after a flight: what the same series take without the control loops.

use crate::distribution::Distribution;
use crate::host::Steal;
use crate::series::{Latencies, Statistics};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// How long each was measured [s].
    pub seconds: f64,
    /// Scheduling of the plant's counterparts: `SCHED_FIFO 80` or `SCHED_OTHER`.
    pub scheduling: String,
    pub refused: Vec<String>,
    pub steal: Steal,
    pub floors: Vec<SeriesBaseline>,
}

/// What the machine can do at the best, for a series of the flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeriesBaseline {
    pub series: String,
    pub what: String,
    pub statistics: Statistics,
    pub distribution: Distribution,
}

impl SeriesBaseline {
    pub fn of(series: &str, what: &str, latencies: &Latencies) -> Self {
        Self {
            series: series.into(),
            what: what.into(),
            statistics: Statistics::of(what, latencies),
            distribution: Distribution::of(what, latencies, 0),
        }
    }
}
