//! Measures the machine's baselines beside a flight.
//!
//! ```text
//!   wake.plant  vs.  a bare timer: one thread that only wakes when each tick begins
//!   loop        vs.  a raw futex ring: four processes that compute for as long as the laws, and pass a token on
//! ```

use std::path::Path;
use std::time::Duration;

use analysis::baseline::{Baseline, SeriesBaseline};
use analysis::schema::Report;
use errors::Failure;
use host::floor::MachineFloor;
use host::floor::ring::Work;
use host::floor::timer::Schedule;
use messages::realtime::RealtimeMode;

use super::flight_runner::series;
use config::{PaceName, Settings};

/// Series of the stages' computing times, in the order of the chain.
const COMPUTE: [&str; 4] = [
    "compute.plant",
    "compute.outer",
    "compute.inner",
    "compute.mixer",
];

pub fn check(settings: &Settings, duration: Duration) -> Result<(), Failure> {
    if settings.flight.pace == PaceName::Lockstep {
        return Err(Failure::usage(
            "lockstep has no deadlines, so there is no baseline to measure",
        )
        .help("fly in real time, without --pace lockstep"));
    }
    if !(Duration::from_secs(1)..=Duration::from_secs(3600)).contains(&duration) {
        return Err(
            Failure::usage(format!("--floor {duration:?}: allowed are 1s to 1h"))
                .help("a 99.9th percentile at 1 kHz needs at least 11s"),
        );
    }
    Ok(())
}

/// Measures each baseline for `duration`, on the CPU and at the priority requested for the flight.
pub fn measure(
    report: &Report,
    settings: &Settings,
    duration: Duration,
    executable: &Path,
) -> Result<MachineFloor, Failure> {
    let realtime = settings.realtime()?;
    let priority = if realtime.mode == RealtimeMode::Off {
        0
    } else {
        realtime.priority
    };
    let schedule = Schedule {
        period_ns: (report.run.wall_period_us * 1e3).round() as u64,
        duration,
        cpu: realtime.cpu,
        priority,
    };
    MachineFloor::measure(&schedule, work_like(report)?, executable)
}

/// The baselines for the report of a flight.
pub fn take(
    report: &Report,
    settings: &Settings,
    duration: Duration,
    executable: &Path,
) -> Result<Baseline, Failure> {
    let floor = measure(report, settings, duration, executable)?;
    Ok(Baseline {
        seconds: duration.as_secs_f64(),
        scheduling: floor.timer.standing.scheduling(),
        refused: floor.refused,
        steal: floor.steal,
        floors: vec![
            SeriesBaseline::of("wake.plant", "bare timer", &floor.timer.lateness),
            SeriesBaseline::of("loop", "raw futex ring", &floor.ring.chain),
        ],
    })
}

/// Work for each process of a ring that takes as long as the flight's laws in the median.
fn work_like(report: &Report) -> Result<Vec<Work>, Failure> {
    COMPUTE
        .into_iter()
        .map(|name| Ok(Work::lasting((series(report, name)?.p50_us * 1e3) as u64)))
        .collect()
}
