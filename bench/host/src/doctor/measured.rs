//! The measured part of an examination: a bare timer, then a raw futex ring, a few seconds each.

use std::path::Path;

use analysis::finding::Finding;
use analysis::host::Steal;
use analysis::series::{Latencies, Statistics};
use errors::Failure;
use messages::role::STAGES;
use serde::{Deserialize, Serialize};

use super::reasons::{reason, steal_finding};
use crate::floor::MachineFloor;
use crate::floor::ring::Work;
use crate::floor::timer::Schedule;

/// Length of a tick of the measurement [ns]: that of a flight by default.
pub const TICK_NS: u64 = 1_000_000;
/// Lateness that takes half of a tick away, so that a chain of loops may miss its deadline [ns].
const LATE_NS: u64 = TICK_NS / 2;
/// Share of late ticks from which on the machine is not real-time capable [%].
const LATE_MAX_PERCENT: f64 = 1.0;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredMachine {
    pub seconds: f64,
    /// Scheduling of the measuring threads: `SCHED_FIFO 80` or `SCHED_OTHER`.
    pub scheduling: String,
    pub cpu: usize,
    pub refused: Vec<String>,
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
    fn of(name: &str, latencies: &Latencies, ticks_skipped: u64) -> Self {
        Self {
            statistics: Statistics::of(name, latencies),
            ticks_skipped,
            late: latencies.len() - latencies.count_between(0, LATE_NS),
        }
    }

    fn finding(&self, subject: &str, what: &str, why: &str) -> Finding {
        let all = &self.statistics;
        let (count, p50_us, p99_us, max_us) = (all.count, all.p50_us, all.p99_us, all.max_us);
        let (late, limit_us) = (self.late, LATE_NS / 1000);
        let found = format!(
            "p50 {p50_us:.1} us, p99 {p99_us:.1} us, max {max_us:.1} us; {late} of {count} {what} than {limit_us} us"
        );
        let finding = Finding::ok(subject, found, why);
        let fix = "find what runs at those times (trace-cmd record -e sched_switch -e irq), and take away what the \
                   other findings name";
        if 100.0 * late as f64 / count.max(1) as f64 > LATE_MAX_PERCENT {
            finding.blocks(fix)
        } else if late > 0 {
            finding.softens(fix)
        } else {
            finding
        }
    }
}

impl MeasuredMachine {
    pub fn take(executable: &Path, schedule: &Schedule) -> Result<Self, Failure> {
        let work = vec![Work::default(); STAGES.len()];
        let floor = MachineFloor::measure(schedule, work, executable)?;
        let (timer, ring) = (&floor.timer, &floor.ring);
        Ok(Self {
            seconds: schedule.duration.as_secs_f64(),
            scheduling: timer.standing.scheduling(),
            cpu: timer.standing.cpu,
            timer: Measurement::of("timer", &timer.lateness, timer.ticks_skipped),
            ring: Measurement::of("ring", &ring.lap, ring.ticks_skipped),
            refused: floor.refused,
            steal: floor.steal,
        })
    }

    pub(super) fn findings(&self) -> Vec<Finding> {
        let timer = "the plant wakes as this thread does, at best";
        let ring = "the loops wake each other as these processes do, at best";
        vec![
            self.timer.finding("timer, measured", "ticks later", timer),
            self.ring.finding("ring, measured", "laps longer", ring),
            steal_finding(&self.steal, &|found| {
                Finding::ok("steal, measured", found, reason("steal since boot"))
            }),
        ]
    }

    pub(super) fn text(&self) -> String {
        let (seconds, scheduling, cpu) = (self.seconds, &self.scheduling, self.cpu);
        let head = format!("\nMeasured for {seconds} s each, {scheduling} on processor {cpu}\n");
        let refused = self.refused.iter();
        refused.fold(head, |text, refused| {
            text + &format!("  refused: {refused}\n")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::finding::{Level, RealtimeClass};

    #[test]
    fn late_ticks_soften_and_many_block_and_so_does_a_host_that_takes_more_than_one_percent() {
        use RealtimeClass::{Hard, NotRealTime, Soft};
        for (late, level, allows) in [
            (0, Level::Ok, Hard),
            (1, Level::Warning, Soft),
            (10, Level::Warning, Soft),
            (11, Level::Blocks, NotRealTime),
        ] {
            let mut lateness = Latencies::new().unwrap();
            (late..1_000).for_each(|_| lateness.record(20_000));
            (0..late).for_each(|_| lateness.record(LATE_NS * 2));
            let measurement = Measurement::of("timer", &lateness, 0);
            assert_eq!(measurement.late, late);
            let finding = measurement.finding("timer", "later", "");
            assert_eq!((finding.level, finding.allows), (level, allows));
            assert_eq!(finding.fix.is_some(), late > 0);
        }
        for (percent, allows) in [(1.0, Hard), (1.2, Soft)] {
            let steal = Steal {
                percent,
                of_ms: 1000,
                ..Steal::default()
            };
            let finding = steal_finding(&steal, &|found| Finding::ok("steal", found, ""));
            assert_eq!(finding.allows, allows);
        }
    }
}
