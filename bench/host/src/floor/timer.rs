//! The floor of wake-ups: one thread on an absolute timer, as in `cyclictest`.

use std::fs::File;
use std::thread;
use std::time::Duration;

use hdrhistogram::Histogram;
use process::rt::{Standing, hold_cpu_latency, loops_cpu, take_stand};

use crate::floor::periodic_timer::PeriodicTimer;
use errors::Failure;

#[derive(Clone, Debug)]
pub struct TimerSettings {
    /// Length of a tick [ns].
    pub period_ns: u64,
    pub duration: Duration,
    /// On which processor; `None` is that of the loops.
    pub cpu: Option<usize>,
    pub priority: i32,
}

#[derive(Clone, Debug)]
pub struct TimerFloor {
    /// From the beginning of each tick to the waking [ns]; ticks slept through enter with their whole lateness.
    pub lateness: Histogram<u64>,
    /// Ticks that it was woken for.
    pub ticks_run: u64,
    pub ticks_skipped: u64,
    pub standing: Standing,
}

/// Measures on a thread of its own.
pub fn measure(settings: &TimerSettings) -> Result<TimerFloor, Failure> {
    let settings = settings.clone();
    let cpu = settings.cpu.unwrap_or_else(loops_cpu);
    on_a_thread("timer floor", move || {
        let mut standing = take_stand(cpu, settings.priority);
        let _awake = stay_awake(&mut standing);
        let mut periodic_timer = PeriodicTimer::new(settings.period_ns, settings.duration)?;
        while periodic_timer.next_wake().is_some() {}
        Ok(TimerFloor {
            ticks_run: periodic_timer.ticks_run(),
            ticks_skipped: periodic_timer.skipped,
            lateness: periodic_timer.lateness,
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
