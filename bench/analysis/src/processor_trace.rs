//! Which threads and interrupts used the processor of the loops, from the kernel trace.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Runner {
    Idle,
    Thread {
        pid: u64,
        /// Its priority as the kernel counts: 0 is the most urgent, below 100 is real time.
        priority: u64,
        name: String,
    },
    Interrupt {
        name: String,
    },
}

impl Runner {
    pub fn words(&self) -> String {
        match self {
            Self::Idle => "idle".into(),
            Self::Thread { pid, name, .. } => format!("{name} ({pid})"),
            Self::Interrupt { name } => name.clone(),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slice {
    pub from_ns: u64,
    pub to_ns: u64,
    pub runner: Runner,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunnerTime {
    pub who: String,
    /// How long [us].
    pub us: f64,
}

impl fmt::Display for RunnerTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {:.0} us", self.who, self.us)
    }
}

/// How long each had the processor in a span; nothing where the trace does not cover at least half of it.
pub fn runners(slices: &[Slice], from_ns: u64, to_ns: u64) -> Option<BTreeMap<&Runner, u64>> {
    let mut times = BTreeMap::<&Runner, u64>::new();
    for slice in slices {
        let ns = slice
            .to_ns
            .min(to_ns)
            .saturating_sub(slice.from_ns.max(from_ns));
        if ns > 0 {
            *times.entry(&slice.runner).or_default() += ns;
        }
    }
    let is_thread = |runner: &Runner| !matches!(runner, Runner::Interrupt { .. });
    let threads = times.iter().filter(|(runner, _)| is_thread(runner));
    let covered_ns: u64 = threads.map(|(_, ns)| ns).sum();
    (covered_ns * 2 >= to_ns.saturating_sub(from_ns) && covered_ns > 0).then_some(times)
}
