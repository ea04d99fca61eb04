//! The machine's floors beside a flight, as part of its report.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

use crate::host::Steal;
use crate::schema::Report;
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
    pub floors: Vec<Floor>,
}

/// What the machine can do at the best, for a series of the flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Floor {
    /// The series of the flight.
    pub series: String,
    /// What was measured.
    pub what: String,
    /// Percentiles.
    pub statistics: Statistics,
    /// How its values are distributed.
    pub distribution: Distribution,
}

/// Name, percentiles, decimals.
pub type Row<'a> = (&'a str, [Option<f64>; 3], usize);

impl Floor {
    /// The floor of a series of the flight.
    #[must_use]
    pub fn of(series: &str, what: &str, histogram: &Histogram<u64>) -> Self {
        Self {
            series: series.into(),
            what: what.into(),
            statistics: Statistics::of(what, histogram),
            distribution: Distribution::of(what, histogram),
        }
    }
}

impl Beside {
    /// The flight's percentiles (p50, p99, p99.9), the floor's, and how many times its floor the flight's are; each with
    /// its name and the decimals that it deserves.
    pub fn rows<'a>(&'a self, report: &'a Report) -> impl Iterator<Item = Row<'a>> {
        let rows = |floor: &'a Floor| {
            let [ours, bare] = [report.series(&floor.series)?, &floor.statistics].map(percentiles);
            let times = std::array::from_fn(|i| Some(ours[i]? / bare[i]?));
            Some([(floor.series.as_str(), ours, 1), (&floor.what, bare, 1), ("times its floor", times, 2)])
        };
        self.floors.iter().filter_map(rows).flatten()
    }

    /// The section of the report for people.
    #[must_use]
    pub fn text(&self, report: &Report) -> String {
        let mut out = format!(
            "\nBeside the machine's floor, {} s each right after the flight ({}, stolen by the host {:.2} %)\n  \
             {:<32} {:>9} {:>9} {:>9}\n",
            self.seconds, self.scheduling, self.steal.percent, "us", "p50", "p99", "p99.9"
        );
        for (name, values, digits) in self.rows(report) {
            let cells =
                values.map(|value| format!(" {:>9}", value.map_or_else(|| "-".into(), |it| format!("{it:.digits$}"))));
            out += &format!("  {name:<32}{}\n", cells.concat());
        }
        for refused in &self.refused {
            out += &format!("  refused: {refused}\n");
        }
        out
    }
}

/// The percentiles that are put beside each other.
fn percentiles(statistics: &Statistics) -> [Option<f64>; 3] {
    [Some(statistics.p50_us), Some(statistics.p99_us), statistics.p999_us]
}
