//! The monotonic clock, which all processes of a machine share.

use std::cell::Cell;

use messages::grid::{NS_PER_S, Pace};
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::{Timespec, clock_gettime};

/// CLOCK_MONOTONIC now [ns]; the same in all processes of a machine.
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * NS_PER_S + now.tv_nsec.unsigned_abs()
}

/// A duration or instant in nanoseconds as the system calls want it.
pub fn timespec(ns: u64) -> Timespec {
    Timespec {
        tv_sec: (ns / NS_PER_S).cast_signed(),
        tv_nsec: (ns % NS_PER_S).cast_signed(),
    }
}

/// Sleeps until an absolute instant of CLOCK_MONOTONIC; returns early only when a signal arrives.
///
/// Returns `false` when it was interrupted.
pub fn sleep_until(instant_ns: u64) -> bool {
    clock_nanosleep_absolute(ClockId::Monotonic, &timespec(instant_ns)).is_ok()
}

/// Sleeps until an instant, through signals; gives when it woke.
pub fn sleep_through(instant_ns: u64) -> u64 {
    loop {
        sleep_until(instant_ns);
        let now = now_ns();
        if now >= instant_ns {
            return now;
        }
    }
}

/// Keeps the processor busy for a time [ns]. Blocks for an instant every 250 ms, counted across calls, so that
/// RLIMIT_RTTIME does not end a thread that calls this in every tick.
pub fn busy_wait(ns: u64) {
    const AT_ONCE_NS: u64 = 250_000_000;
    const INSTANT_NS: u64 = 1_000;
    thread_local!(static SLEPT_NS: Cell<u64> = const { Cell::new(0) });
    let until_ns = now_ns().saturating_add(ns);
    while now_ns() < until_ns {
        if now_ns() >= SLEPT_NS.get() + AT_ONCE_NS {
            sleep_until(now_ns() + INSTANT_NS);
            SLEPT_NS.set(now_ns());
        }
        std::hint::spin_loop();
    }
}

/// The latest tick whose messages may exist, at the instant of the call.
///
/// A receiver calls it after it has received a message: an earlier value would be too old if the machine has stalled in
/// between, and good messages of later ticks would be taken for forged ones.
pub trait Horizon: Copy {
    fn latest_tick(&self) -> u64;
}

impl Horizon for Pace {
    fn latest_tick(&self) -> u64 {
        self.newest_tick(now_ns())
    }
}

impl<F: Fn() -> u64 + Copy> Horizon for F {
    fn latest_tick(&self) -> u64 {
        self()
    }
}

/// A known tick, whatever the time.
impl Horizon for u64 {
    fn latest_tick(&self) -> u64 {
        *self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_is_busy_again_and_again_blocks_within_half_a_second() {
        let times_blocked = || -> u64 {
            let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
            let mut lines = status.lines();
            let times = lines.find_map(|it| it.strip_prefix("voluntary_ctxt_switches:"));
            times.unwrap().trim().parse().unwrap()
        };
        busy_wait(1);
        let before = times_blocked();
        (0..100).for_each(|_| busy_wait(5_000_000));
        assert!(times_blocked() > before);
    }
}
