//! What a loop has used since it was armed.
//!
//! It counts page faults, context switches, allocations and processor time.

use super::allocations::thread_allocations;
use super::sys;
use model::realtime::Usage;

/// Measures the calling thread from its creation on.
#[derive(Clone, Copy, Debug)]
pub struct UsageMeter {
    start: sys::ThreadUsage,
    allocations: u64,
}

impl UsageMeter {
    /// Starts to measure.
    #[must_use]
    pub fn start() -> Self {
        Self { allocations: thread_allocations(), start: sys::thread_usage() }
    }

    /// What the thread used since the start.
    #[must_use]
    pub fn read(&self) -> Usage {
        let now = sys::thread_usage();
        Usage {
            minor_faults: now.minor_faults - self.start.minor_faults,
            major_faults: now.major_faults - self.start.major_faults,
            voluntary_switches: now.voluntary_switches - self.start.voluntary_switches,
            involuntary_switches: now.involuntary_switches - self.start.involuntary_switches,
            allocations: thread_allocations() - self.allocations,
            cpu_ns: now.cpu_ns - self.start.cpu_ns,
        }
    }
}
