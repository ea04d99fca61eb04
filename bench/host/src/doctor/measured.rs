//! The measured part of an examination: a bare timer, then a raw futex ring.
//!
//! Each runs for a few seconds.

use std::path::Path;
use std::time::Duration;

use hdrhistogram::Histogram;
use messages::role::STAGES;
use process::rt::loops_cpu;
use serde::{Deserialize, Serialize};

use crate::cpu_times::CpuTimes;
use crate::doctor::load::stolen;
use crate::floor::link::WakeMechanism;
use crate::floor::work::Work;
use crate::floor::{ring, timer};
use errors::Failure;
use report::finding::Finding;
use report::host::Steal;
use report::series::Statistics;

/// Length of a tick of the measurement [ns]: that of a flight by default.
pub const TICK_NS: u64 = 1_000_000;
/// Lateness that takes half of a tick away, so that a chain of loops may miss its deadline [ns].
pub const LATE_NS: u64 = TICK_NS / 2;
/// Share of late ticks from which on the machine is no real-time machine [%].
pub const LATE_MAX_PERCENT: f64 = 1.0;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredMachine {
    /// How long the timer and the ring were measured, each [s].
    pub seconds: f64,
    /// Scheduling of the measuring threads: `SCHED_FIFO 80` or `SCHED_OTHER`.
    pub scheduling: String,
    pub cpu: usize,
    /// What the system refused to the measuring threads.
    pub refused: Vec<String>,
    /// Lateness of a thread on an absolute timer.
    pub timer: Measurement,
    /// Time of a token's lap through four processes, woken by futex.
    pub ring: Measurement,
    pub steal: Steal,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    pub statistics: Statistics,
    /// Ticks slept through; the timer's are in its percentiles with their whole lateness.
    pub ticks_skipped: u64,
    /// Ticks that were late, or laps that took as long: more than half a tick.
    pub late: u64,
}

impl Measurement {
    fn of(name: &str, histogram: &Histogram<u64>, ticks_skipped: u64) -> Self {
        let late = histogram.len() - histogram.count_between(0, LATE_NS);
        Self {
            statistics: Statistics::of(name, histogram),
            ticks_skipped,
            late,
        }
    }

    fn late_percent(&self) -> f64 {
        100.0 * self.late as f64 / self.statistics.count.max(1) as f64
    }
}

impl MeasuredMachine {
    /// Measures for `duration` each, at the priorities of the loops on processor `cpu`.
    pub fn take(
        executable: &Path,
        duration: Duration,
        priority: i32,
        cpu: Option<usize>,
    ) -> Result<Self, Failure> {
        let processor = Some(cpu.unwrap_or_else(loops_cpu) as u64);
        let before = CpuTimes::read(processor);
        let timer = timer::measure(&timer::TimerSettings {
            period_ns: TICK_NS,
            duration,
            cpu,
            priority,
        })?;
        let work = vec![Work::default(); STAGES.len()];
        let settings = ring::RingSettings {
            wake: WakeMechanism::Futex,
            period_ns: TICK_NS,
            duration,
            cpu,
            priority,
            work,
            rehearsal: None,
        };
        let ring = ring::measure(&settings, executable)?;
        let mut refused = timer.standing.refused.clone();
        refused.extend(ring.standing.refused.iter().cloned());
        refused.dedup();
        Ok(Self {
            seconds: duration.as_secs_f64(),
            scheduling: timer.standing.scheduling(),
            cpu: timer.standing.cpu,
            refused,
            timer: Measurement::of("timer", &timer.lateness, timer.ticks_skipped),
            ring: Measurement::of("ring", &ring.lap, ring.ticks_skipped),
            steal: before.steal_until(&CpuTimes::read(processor)),
        })
    }

    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        let disturbed = "find what runs at those times (trace-cmd record -e sched_switch -e irq), and take away what the \
                         other findings name";
        let judge = |subject: &str, what: &str, measurement: &Measurement, why: &str| {
            let percent = measurement.late_percent();
            let (p50, p99) = (measurement.statistics.p50_us, measurement.statistics.p99_us);
            let found = format!(
                "p50 {p50:.1} us, p99 {p99:.1} us; {} of {} {what} than {} us",
                measurement.late,
                measurement.statistics.count,
                LATE_NS / 1000
            );
            let finding = Finding::ok(subject, found, why);
            if percent > LATE_MAX_PERCENT {
                finding.blocks(disturbed)
            } else if measurement.late > 0 {
                finding.softens(disturbed)
            } else {
                finding
            }
        };
        vec![
            judge(
                "timer, measured",
                "ticks later",
                &self.timer,
                "the plant wakes as this thread does, at best",
            ),
            judge(
                "ring, measured",
                "laps longer",
                &self.ring,
                "the loops wake each other as these processes do, at best",
            ),
            stolen("steal, measured", &self.steal),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use report::finding::{Level, RealtimeClass};
    use report::series::histogram;

    fn measured(late: u64) -> MeasuredMachine {
        let mut lateness = histogram().unwrap();
        lateness.record_n(20_000, 1_000 - late).unwrap();
        lateness.record_n(LATE_NS * 2, late).unwrap();
        let measurement = Measurement::of("timer", &lateness, 0);
        assert_eq!(measurement.late, late);
        MeasuredMachine {
            seconds: 1.0,
            scheduling: "SCHED_FIFO 80".into(),
            cpu: 1,
            refused: vec![],
            timer: measurement.clone(),
            ring: measurement,
            steal: Steal::default(),
        }
    }

    #[test]
    fn late_ticks_soften_and_many_block() {
        let of = |late| {
            let finding = measured(late).findings().remove(0);
            (finding.level, finding.allows, finding.fix.is_some())
        };
        assert_eq!(of(0), (Level::Ok, RealtimeClass::Hard, false));
        assert_eq!(of(1), (Level::Warning, RealtimeClass::Soft, true));
        assert_eq!(of(10), (Level::Warning, RealtimeClass::Soft, true));
        assert_eq!(of(11), (Level::Blocks, RealtimeClass::NotRealTime, true));
    }

    #[test]
    fn a_host_that_takes_more_than_one_percent_softens() {
        let mut measured = measured(0);
        measured.steal = Steal {
            stolen_ms: 120,
            percent: 1.2,
            of_ms: 10_000,
            processor: None,
        };
        assert_eq!(
            measured.findings().last().map(|finding| finding.allows),
            Some(RealtimeClass::Soft)
        );
    }
}
