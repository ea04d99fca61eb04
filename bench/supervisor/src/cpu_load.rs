//! `ironbird cpu-load`: a process that keeps the loops' processor busy; the supervisor starts it.

use std::ops::Range;

use ipc::clock::{busy_wait, now_ns, sleep_through, sleep_until};
use process::rt::take_stand;

use errors::{Failure, OK};

/// The time of which a share is busy [ns].
const CYCLE_NS: u64 = 10_000_000;

/// Keeps a processor busy in this share of a time on CLOCK_MONOTONIC [ns]. Priority 0 is SCHED_OTHER.
pub fn cpu_load(
    (cpu, priority): (usize, i32),
    share: f64,
    time_ns: Range<u64>,
) -> Result<u8, Failure> {
    sleep_through(time_ns.start);
    let standing = take_stand(cpu, priority);
    if standing.priority != priority || !standing.refused.is_empty() {
        return Err(Failure::failed(format!(
            "the processor is not kept busy: {}",
            standing.refused.join(", ")
        )));
    }
    let busy_ns = (share.clamp(0.0, 1.0) * CYCLE_NS as f64) as u64;
    let mut cycle_ns = now_ns();
    while cycle_ns < time_ns.end {
        busy_wait(busy_ns.min(time_ns.end - cycle_ns));
        if busy_ns < CYCLE_NS {
            sleep_until(cycle_ns + CYCLE_NS);
        }
        cycle_ns = now_ns();
    }
    Ok(OK)
}
