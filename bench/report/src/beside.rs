//! The machine's floors, measured after a flight, as part of its report.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use crate::host::Steal;
use crate::tally::distribution::Distribution;
use crate::tally::series::Statistics;

/// The floors of a flight's series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beside {
    /// How long each was measured [s].
    pub seconds: f64,
    /// Scheduling of the plant's counterparts: `SCHED_FIFO 80` or `SCHED_OTHER`.
    pub scheduling: String,
    /// What the system refused to them.
    pub refused: Vec<String>,
    /// What the host took meanwhile.
    pub steal: Steal,
    /// The floors.
    pub floors: Vec<SeriesFloor>,
}

/// What the machine can do at the best, for a series of the flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeriesFloor {
    /// The series of the flight.
    pub series: String,
    /// What was measured.
    pub what: String,
    /// Percentiles.
    pub statistics: Statistics,
    /// How its values are distributed.
    pub distribution: Distribution,
}

impl SeriesFloor {
    /// The floor of a series of the flight.
    #[must_use]
    pub fn of(series: &str, what: &str, histogram: &Histogram<u64>) -> Self {
        Self {
            series: series.into(),
            what: what.into(),
            statistics: Statistics::of(what, histogram),
            distribution: Distribution::of(what, histogram, 0),
        }
    }
}
