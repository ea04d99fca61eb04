//! The machine's floors beside a flight: measured right after it, as it flew, and part of its report.
//!
//! ```text
//!   wake.plant  beside  a bare timer: one thread that does nothing but wake at each tick's begin
//!   loop        beside  a raw futex ring: four processes that compute as long as the laws took, and hand on a token
//! ```

use std::path::Path;
use std::time::Duration;

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use shared::rt::Mode;

use super::flight::series;
use super::link::Wake;
use super::work::Work;
use super::{ring, timer};
use crate::failure::Failure;
use crate::record::distribution::Distribution;
use crate::record::host::{CpuTimes, Steal};
use crate::record::report::Report;
use crate::record::series::Statistics;
use crate::settings::{PaceName, Settings};

/// Series of the stages' computing, in the order of the chain.
const COMPUTE: [&str; 4] = ["compute.plant", "compute.outer", "compute.inner", "compute.mixer"];

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
    fn of(series: &str, what: &str, histogram: &Histogram<u64>) -> Self {
        Self {
            series: series.into(),
            what: what.into(),
            statistics: Statistics::of(what, histogram),
            distribution: Distribution::of(what, histogram),
        }
    }
}

impl Beside {
    /// Refuses flights that have no floor.
    ///
    /// # Errors
    /// Usage, for a flight in lockstep and for a duration without a tick.
    pub fn check(settings: &Settings, duration: Duration) -> Result<(), Failure> {
        if settings.flight.pace == PaceName::Lockstep {
            return Err(Failure::usage("--floor: in lockstep nothing is late, so there is no floor to measure")
                .help("fly in real time, or measure the floor of lockstep with `ironbird floor --only lockstep`"));
        }
        if !(Duration::from_secs(1)..=Duration::from_secs(3600)).contains(&duration) {
            return Err(Failure::usage(format!("--floor {duration:?}: allowed are 1s to 1h"))
                .help("11s and more, for a 99.9th percentile at 1 kHz"));
        }
        Ok(())
    }

    /// Measures for `duration` each, on the processor and at the priority that the flight asked for.
    ///
    /// # Errors
    /// Those of [`timer::measure`] and [`ring::measure`], and of a report without the series of a flight.
    pub fn take(report: &Report, settings: &Settings, duration: Duration, executable: &Path) -> Result<Self, Failure> {
        let realtime = settings.realtime()?;
        let priority = if realtime.mode == Mode::Off { 0 } else { realtime.priority };
        let period_ns = (report.run.wall_period_us * 1e3).round() as u64;
        let before = CpuTimes::read();
        let timer = timer::measure(&timer::Settings { period_ns, duration, cpu: realtime.cpu, priority })?;
        let ring = ring::Settings {
            wake: Wake::Futex,
            period_ns,
            duration,
            cpu: realtime.cpu,
            priority,
            work: computing_as(report)?,
        };
        let ring = ring::measure(&ring, executable)?;
        let mut refused = timer.standing.refused.clone();
        refused.extend(ring.standing.refused);
        refused.dedup();
        Ok(Self {
            seconds: duration.as_secs_f64(),
            scheduling: timer.standing.scheduling(),
            refused,
            steal: before.steal_until(&CpuTimes::read()),
            floors: vec![
                Floor::of("wake.plant", "bare timer", &timer.lateness),
                Floor::of("loop", "raw futex ring", &ring.chain),
            ],
        })
    }

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

/// As much work for each process of a ring as the flight's laws took in the median.
///
/// # Errors
/// [`Failure`] where the report lacks a series.
pub fn computing_as(report: &Report) -> Result<Vec<Work>, Failure> {
    COMPUTE.into_iter().map(|name| Ok(Work::lasting((series(report, name)?.p50_us * 1e3) as u64))).collect()
}
