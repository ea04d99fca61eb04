//! Facts about the machine, stolen processor time, and interrupts.

use serde::{Deserialize, Serialize};

/// Stolen time above which latencies tell of the host, and not of the loops [%].
pub const STEAL_LIMIT_PERCENT: f64 = 1.0;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Host {
    pub kernel: String,
    pub preemption: String,
    pub cpu: String,
    pub cpus: u64,
    /// Whether a hypervisor runs below; none where that is not known.
    pub hypervisor: Option<bool>,
    pub clock_source: String,
    /// /proc/sys/kernel/sched_rt_runtime_us: what SCHED_FIFO gets of each period; -1 is all.
    pub rt_runtime_us: i64,
}

impl Host {
    /// Whether a hypervisor runs below, after a list of what does.
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
    pub percent: f64,
    /// Their time [ms]; 0 where the kernel counts none.
    pub of_ms: u64,
    /// The processor; none where it is all of them together.
    pub processor: Option<u64>,
}

impl Steal {
    pub fn processors(&self) -> String {
        match self.processor {
            None => "all processors".into(),
            Some(number) => format!("processor {number}"),
        }
    }
}

/// Limits of the container (control group) that the loops flew in, and what its processor quota took from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContainerSection {
    /// Its processor quota; none where it has none.
    pub processors: Option<f64>,
    /// Likewise [MiB].
    pub memory_mib: Option<f64>,
    /// Periods of the flight in which the quota was used up.
    pub throttled_periods: u64,
    /// How long processes then stood still, summed over the processors [us]. Real-time processes go on.
    pub throttled_us: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InterruptKind {
    Hard,
    /// What the kernel put off until after such an interrupt.
    Soft,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InterruptCount {
    pub kind: InterruptKind,
    /// As the kernel names it: a number, or letters such as `LOC`; or a soft one such as `TIMER`.
    pub name: String,
    /// The device or the reason; empty for soft ones.
    pub source: String,
    pub count: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InterruptSection {
    /// The processor; none where the loops did not share one, and all are counted together.
    pub processor: Option<u64>,
    pub counts: Vec<InterruptCount>,
}
