//! The monotonic clock, which all processes of a machine share.

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

/// Keeps the processor busy for a time [ns]. Sleeps for an instant every 250 ms, because the kernel ends a thread that runs
/// longer than RLIMIT_RTTIME without blocking.
pub fn busy_wait(ns: u64) {
    const AT_ONCE_NS: u64 = 250_000_000;
    const INSTANT_NS: u64 = 1_000;
    let until_ns = now_ns().saturating_add(ns);
    let mut part_ns = now_ns() + AT_ONCE_NS;
    while now_ns() < until_ns {
        if now_ns() >= part_ns {
            sleep_until(now_ns() + INSTANT_NS);
            part_ns = now_ns() + AT_ONCE_NS;
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
