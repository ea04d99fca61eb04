//! Facts about the machine, and how much processor time others took.

use serde::{Deserialize, Serialize};

/// Stolen time above which latencies tell of the host, and not of the loops [%].
pub const STEAL_LIMIT_PERCENT: f64 = 1.0;

/// The machine, as far as it explains latencies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Host {
    /// Kernel release and build.
    pub kernel: String,
    /// Preemption model, as far as the kernel says.
    pub preemption: String,
    /// Processor.
    pub cpu: String,
    /// Processors online.
    pub cpus: u64,
    /// Whether a hypervisor runs below; none where that is not known.
    pub hypervisor: Option<bool>,
    /// Clock source in use.
    pub clock_source: String,
    /// /proc/sys/kernel/sched_rt_runtime_us: what SCHED_FIFO gets of each period; -1 is all.
    pub rt_runtime_us: i64,
}

impl Host {
    /// Whether a hypervisor runs below, after a list of what does.
    #[must_use]
    pub const fn below(&self) -> &'static str {
        match self.hypervisor {
            Some(true) => ", under a hypervisor",
            Some(false) => "",
            None => ", perhaps under a hypervisor",
        }
    }
}

/// Time that the host took from one processor, or from all of them together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Steal {
    /// Stolen [ms], in the kernel's resolution of 10 ms.
    pub stolen_ms: u64,
    /// Share of their time [%].
    pub percent: f64,
}
