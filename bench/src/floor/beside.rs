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

    /// The floor of a series.
    #[must_use]
    pub fn of(&self, series: &str) -> Option<&Floor> {
        self.floors.iter().find(|floor| floor.series == series)
    }

    /// The section of the report for people.
    #[must_use]
    pub fn text(&self, report: &Report) -> String {
        let mut out = format!(
            "\nBeside the machine's floor, {} s each right after the flight ({}, stolen by the host {:.2} %)\n  \
             {:<32} {:>9} {:>9} {:>9}\n",
            self.seconds, self.scheduling, self.steal.percent, "us", "p50", "p99", "p99.9"
        );
        for floor in &self.floors {
            let Some(flown) = report.series(&floor.series) else { continue };
            let [ours, bare] = [flown, &floor.statistics].map(percentiles);
            let ratios: Vec<_> = ours.iter().zip(bare).map(|(ours, bare)| Some((*ours)? / bare?)).collect();
            let cells = |values: &[Option<f64>], digits: usize| {
                let cell = |value: &Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"));
                values.iter().map(|value| format!(" {:>9}", cell(value))).collect::<String>()
            };
            out += &format!("  {:<32}{}\n", floor.series, cells(&ours, 1));
            out += &format!("  {:<32}{}\n", floor.what, cells(&bare, 1));
            out += &format!("  {:<32}{}\n", "times its floor", cells(&ratios, 2));
        }
        for refused in &self.refused {
            out += &format!("  refused: {refused}\n");
        }
        out
    }
}

/// The percentiles that are put beside each other.
#[must_use]
pub fn percentiles(statistics: &Statistics) -> [Option<f64>; 3] {
    [Some(statistics.p50_us), Some(statistics.p99_us), statistics.p999_us]
}

/// As much work for each process of a ring as the flight's laws took in the median.
///
/// # Errors
/// [`Failure`] where the report lacks a series.
pub fn computing_as(report: &Report) -> Result<Vec<Work>, Failure> {
    let lasting = |name: &str| {
        let series = report.series(name);
        let series = series.ok_or_else(|| Failure::failed(format!("the flight's report has no series `{name}`")))?;
        Ok(Work::lasting((series.p50_us * 1e3) as u64))
    };
    COMPUTE.into_iter().map(lasting).collect()
}
