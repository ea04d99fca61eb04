//! Measures the machine's floors right after a flight, for its report.
//!
//! ```text
//!   wake.plant  beside  a bare timer: one thread that only wakes when each tick begins
//!   loop        beside  a raw futex ring: four processes that compute for as long as the laws, and pass a token on
//! ```

use std::path::Path;
use std::time::Duration;

use failure::Failure;
use machine::cpu_times::CpuTimes;
use machine::floor::link::WakeMechanism;
use machine::floor::work::Work;
use machine::floor::{ring, timer};
use model::realtime::RealtimeMode;
use report::beside::{Beside, SeriesFloor};
use report::schema::Report;
use role::rt::loops_cpu;

use super::flight::series;
use crate::settings::{PaceName, Settings};

/// Series of the stages' computing, in the order of the chain.
const COMPUTE: [&str; 4] = ["compute.plant", "compute.outer", "compute.inner", "compute.mixer"];

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
pub fn take(report: &Report, settings: &Settings, duration: Duration, executable: &Path) -> Result<Beside, Failure> {
    let realtime = settings.realtime()?;
    let priority = if realtime.mode == RealtimeMode::Off { 0 } else { realtime.priority };
    let period_ns = (report.run.wall_period_us * 1e3).round() as u64;
    let processor = Some(realtime.cpu.unwrap_or_else(loops_cpu) as u64);
    let before = CpuTimes::read(processor);
    let timer = timer::measure(&timer::TimerSettings { period_ns, duration, cpu: realtime.cpu, priority })?;
    let ring = ring::RingSettings {
        wake: WakeMechanism::Futex,
        period_ns,
        duration,
        cpu: realtime.cpu,
        priority,
        work: computing_as(report)?,
        rehearsal: None,
    };
    let ring = ring::measure(&ring, executable)?;
    let mut refused = timer.standing.refused.clone();
    refused.extend(ring.standing.refused);
    refused.dedup();
    Ok(Beside {
        seconds: duration.as_secs_f64(),
        scheduling: timer.standing.scheduling(),
        refused,
        steal: before.steal_until(&CpuTimes::read(processor)),
        floors: vec![
            SeriesFloor::of("wake.plant", "bare timer", &timer.lateness),
            SeriesFloor::of("loop", "raw futex ring", &ring.chain),
        ],
    })
}

/// As much work for each process of a ring as the flight's laws took in the median.
///
/// # Errors
/// [`Failure`] where the report lacks a series.
pub fn computing_as(report: &Report) -> Result<Vec<Work>, Failure> {
    COMPUTE.into_iter().map(|name| Ok(Work::lasting((series(report, name)?.p50_us * 1e3) as u64))).collect()
}
