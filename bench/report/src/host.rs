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
    /// Whether a hypervisor runs below.
    pub hypervisor: bool,
    /// Clock source in use.
    pub clock_source: String,
    /// /proc/sys/kernel/sched_rt_runtime_us: what SCHED_FIFO gets of each period; -1 is all.
    pub rt_runtime_us: i64,
}

/// Time that the host took from one processor, or from all of them together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Steal {
    /// Stolen [ms], in the kernel's resolution of 10 ms.
    pub stolen_ms: u64,
    /// Share of their time [%].
    pub percent: f64,
    /// Their time [ms]; 0 where the kernel counts none, and in reports from before it was kept.
    #[serde(default)]
    pub of_ms: u64,
    /// The processor; none where it is all of them together.
    #[serde(default)]
    pub processor: Option<u64>,
}

impl Steal {
    /// Whose time it is, in words.
    #[must_use]
    pub fn processors(&self) -> String {
        self.processor.map_or_else(|| "all processors".into(), |number| format!("processor {number}"))
    }
}
