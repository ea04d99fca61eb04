//! Real time for one thread: scheduling, affinity and timer slack, as in a loop.
//!
//! It is for threads that measure the machine beside the loops. A role's whole set-up is [`super::Engaged`].

use std::hint::black_box;
use std::io;
use std::num::NonZero;
use std::sync::OnceLock;

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity, set_current_timer_slack};
use serde::{Deserialize, Serialize};

use super::sys;

/// Stack that is touched in advance [bytes].
const STACK_BYTES: usize = 256 << 10;

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standing {
    /// SCHED_FIFO priority in force; 0 is SCHED_OTHER.
    pub priority: i32,
    pub cpu: usize,
    pub refused: Vec<String>,
}

impl Standing {
    pub fn scheduling(&self) -> String {
        if self.priority > 0 {
            format!("SCHED_FIFO {}", self.priority)
        } else {
            "SCHED_OTHER".into()
        }
    }
}

/// The calling thread under the lowest SCHED_FIFO priority, until this is dropped: above all that is not real-time, and
/// below every loop. What it starts is not. Where that is refused, or it is under real time already, it stays as it was.
#[derive(Debug)]
pub struct Raised {
    is_raised: bool,
}

impl Raised {
    pub fn now() -> Self {
        let is_ordinary = sys::scheduler().is_ok_and(|(_, priority)| priority == 0);
        Self {
            is_raised: is_ordinary && sys::set_lowest_fifo().is_ok(),
        }
    }
}

impl Drop for Raised {
    fn drop(&mut self) {
        if self.is_raised {
            // A process may always put its own threads under SCHED_OTHER.
            let _ = sys::set_other(0);
        }
    }
}

/// Puts the calling thread on a processor under SCHED_FIFO, without timer slack, and touches its stack.
///
/// Each step is tried, and what is refused is said. A priority of 0 leaves it under SCHED_OTHER.
pub fn take_stand(cpu: usize, priority: i32) -> Standing {
    let mut refused = Vec::new();
    let mut attempt = |what: &str, outcome: io::Result<()>| {
        if let Err(reason) = outcome {
            refused.push(format!("{what}: {reason}"));
        }
    };
    attempt(
        "timer slack",
        set_current_timer_slack(NonZero::new(1)).map_err(Into::into),
    );
    attempt(
        &format!("processor {cpu}"),
        sched_setaffinity(None, &of_cpus(&[cpu])).map_err(Into::into),
    );
    prefault_stack();
    if priority > 0 {
        attempt("SCHED_FIFO", sys::set_fifo(priority));
    }
    let priority = sys::scheduler().map_or(0, |(_, priority)| priority);
    Standing {
        priority,
        cpu,
        refused,
    }
}

/// Why a thread of this process cannot have SCHED_FIFO at a priority; nothing where it can.
pub fn fifo_refusal(priority: i32) -> Option<io::Error> {
    let tried = std::thread::Builder::new()
        .name("fifo probe".into())
        .spawn(move || sys::set_fifo(priority));
    match tried.map(std::thread::JoinHandle::join) {
        Ok(Ok(outcome)) => outcome.err(),
        Ok(Err(_)) => Some(io::Error::other("the thread that tried it panicked")),
        Err(reason) => Some(reason),
    }
}

/// The processor of the loops where the user names none: the highest-numbered one allowed.
pub fn loops_cpu() -> usize {
    let allowed = allowed_cpus();
    (0..CpuSet::MAX_CPU)
        .rev()
        .find(|cpu| allowed.is_set(*cpu))
        .unwrap_or(0)
}

/// The processors of loops that share so many, the plant's first: `first`, and the highest-numbered other ones allowed.
/// Fewer where no more are allowed.
pub fn loop_processors(first: usize, loop_cpus: usize) -> Vec<usize> {
    let allowed = allowed_cpus();
    let lower = (0..CpuSet::MAX_CPU).rev().filter(|cpu| *cpu != first);
    std::iter::once(first)
        .chain(lower.filter(|cpu| allowed.is_set(*cpu)))
        .take(loop_cpus)
        .collect()
}

/// What this process may use, as its launcher had it before it kept to some processors itself.
static ALLOWED: OnceLock<CpuSet> = OnceLock::new();

/// Takes the processors that the launcher may use for those that this process may use.
pub fn allow_cpus(cpus: &[usize]) {
    let _ = ALLOWED.set(of_cpus(cpus));
}

/// The processors that the kernel's sets have room for.
pub(super) fn of_cpus(cpus: &[usize]) -> CpuSet {
    let mut set = CpuSet::new();
    for cpu in cpus.iter().filter(|cpu| **cpu < CpuSet::MAX_CPU) {
        set.set(*cpu);
    }
    set
}

pub(super) fn allowed_cpus() -> CpuSet {
    if let Some(allowed) = ALLOWED.get() {
        return *allowed;
    }
    // Without the list (which cannot fail for the caller itself), processor 0 always exists.
    sched_getaffinity(None).unwrap_or_else(|_| of_cpus(&[0]))
}

#[inline(never)]
pub(super) fn prefault_stack() {
    black_box([1_u8; STACK_BYTES]);
}

#[cfg(test)]
mod tests {
    use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities};

    use super::*;

    #[test]
    fn a_raised_thread_returns_to_its_scheduling_even_without_privileges() {
        // In threads of their own, which end with what they have given up. A priority of 0 is SCHED_OTHER.
        for priority in [0, 3] {
            let scheduling = std::thread::spawn(move || {
                let is_fifo = priority > 0 && sys::set_fifo(priority).is_ok();
                let before = sys::scheduler().unwrap();
                let raised = Raised::now();
                let up = sys::scheduler().unwrap();
                if !is_fifo {
                    // As for a user with RLIMIT_RTPRIO, who may not clear the flag of a raised thread.
                    let sets = CapabilitySets {
                        effective: CapabilitySet::empty(),
                        permitted: CapabilitySet::empty(),
                        inheritable: CapabilitySet::empty(),
                    };
                    set_capabilities(None, sets).unwrap();
                }
                drop(raised);
                (before, up, sys::scheduler().unwrap())
            });
            let (before, up, after) = scheduling.join().unwrap();
            assert_eq!(after, before, "after {up:?}");
        }
    }
}
