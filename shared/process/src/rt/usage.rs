//! What a loop has used since it was armed.
//!
//! It counts page faults, context switches, allocations and processor time.

use super::allocations::{are_counted, thread_allocations};
use super::sys;
use messages::realtime::Usage;

#[derive(Clone, Copy, Debug)]
pub struct UsageMeter {
    start: Usage,
    allocations: Option<u64>,
}

impl UsageMeter {
    pub fn start() -> Self {
        Self {
            allocations: are_counted().then(thread_allocations),
            start: sys::thread_usage(),
        }
    }

    pub fn read(&self) -> Usage {
        let now = sys::thread_usage();
        Usage {
            minor_faults: now.minor_faults - self.start.minor_faults,
            major_faults: now.major_faults - self.start.major_faults,
            voluntary_switches: now.voluntary_switches - self.start.voluntary_switches,
            involuntary_switches: now.involuntary_switches - self.start.involuntary_switches,
            allocations: self
                .allocations
                .map_or(Usage::NOT_COUNTED, |start| thread_allocations() - start),
            cpu_ns: now.cpu_ns - self.start.cpu_ns,
        }
    }
}
