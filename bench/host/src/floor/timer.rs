//! The floor of wake-ups: one thread on an absolute timer, as in `cyclictest`.

use std::fs::File;
use std::thread;
use std::time::Duration;

use analysis::series::Latencies;
use errors::Failure;
use ipc::clock::{now_ns, sleep_until};
use messages::grid::Grid;
use process::rt::{Standing, hold_cpu_latency, loops_cpu, take_stand};

#[derive(Clone, Debug, Default)]
pub struct Schedule {
    pub period_ns: u64,
    pub duration: Duration,
    /// On which processor; `None` is that of the loops.
    pub cpu: Option<usize>,
    /// SCHED_FIFO priority; 0 is SCHED_OTHER.
    pub priority: i32,
}

#[derive(Clone, Debug)]
pub struct TimerFloor {
    /// From the beginning of each tick to the waking [ns]; ticks slept through enter with their whole lateness.
    pub lateness: Latencies,
    pub ticks_skipped: u64,
    pub standing: Standing,
}

pub fn measure(schedule: &Schedule) -> Result<TimerFloor, Failure> {
    let schedule = schedule.clone();
    on_a_thread("timer floor", move || {
        let cpu = schedule.cpu.unwrap_or_else(loops_cpu);
        let mut standing = take_stand(cpu, schedule.priority);
        let _awake = stay_awake(&mut standing);
        let mut timer = PeriodicTimer::new(schedule.period_ns, schedule.duration)?;
        while timer.next_wake().is_some() {}
        Ok(TimerFloor {
            ticks_skipped: timer.skipped,
            lateness: timer.lateness,
            standing,
        })
    })
}

/// Keeps the processors awake as the loops do, which under SCHED_OTHER do not.
pub(super) fn stay_awake(standing: &mut Standing) -> Option<File> {
    if standing.priority == 0 {
        return None;
    }
    hold_cpu_latency()
        .map_err(|e| standing.refused.push(format!("/dev/cpu_dma_latency: {e}")))
        .ok()
}

/// Measures on a thread, so that priority and processor end with it.
pub(super) fn on_a_thread<T: Send + 'static>(
    name: &str,
    measure: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    thread::Builder::new()
        .name(name.into())
        .spawn(measure)
        .map_err(|e| Failure::failed(format!("cannot start the thread `{name}`: {e}")))?
        .join()
        .unwrap_or_else(|_| Err(Failure::failed(format!("the thread `{name}` panicked"))))
}

/// From the making of a periodic timer to its first tick [ns].
const BEGINS_NS: u64 = 2_000_000;

/// Wakes the calling thread tick after tick, and records how late.
pub(super) struct PeriodicTimer {
    grid: Grid,
    next_tick: u64,
    ticks: u64,
    pub lateness: Latencies,
    pub skipped: u64,
}

impl PeriodicTimer {
    /// Begins in 2 ms and runs for `duration`; a tick takes `period_ns`.
    pub fn new(period_ns: u64, duration: Duration) -> Result<Self, Failure> {
        let ticks = duration.as_nanos() / u128::from(period_ns.max(1));
        if ticks == 0 {
            return Err(Failure::usage(format!(
                "no tick of {period_ns} ns fits into {duration:?}"
            ))
            .help("measure for longer, as in --seconds 5"));
        }
        let mut lateness = Latencies::new()?;
        // Writes its counts once, so that no page of them is missing when it matters.
        lateness.record(1);
        lateness.clear();
        let t0_ns = now_ns() + BEGINS_NS;
        Ok(Self {
            grid: Grid { t0_ns, period_ns },
            next_tick: 0,
            ticks: u64::try_from(ticks).unwrap_or(u64::MAX),
            lateness,
            skipped: 0,
        })
    }

    /// Sleeps until the next tick; gives when the thread woke [ns], and nothing after the last tick.
    pub fn next_wake(&mut self) -> Option<u64> {
        if self.next_tick >= self.ticks {
            return None;
        }
        let begin_ns = self.grid.begin_of(self.next_tick);
        let mut woken_ns = now_ns();
        while woken_ns < begin_ns {
            sleep_until(begin_ns);
            woken_ns = now_ns();
        }
        let current = self.grid.tick_at(woken_ns).min(self.ticks - 1);
        for owed in self.next_tick..=current {
            self.lateness.record(woken_ns - self.grid.begin_of(owed));
        }
        self.skipped += current - self.next_tick;
        self.next_tick = current + 1;
        Some(woken_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_tick_begins_early_and_none_is_left_out() {
        let mut timer = PeriodicTimer::new(1_000_000, Duration::from_millis(20)).unwrap();
        while let Some(woken_ns) = timer.next_wake() {
            assert!(woken_ns >= timer.grid.begin_of(timer.next_tick - 1));
        }
        assert_eq!(timer.lateness.len(), 20);
    }
}
