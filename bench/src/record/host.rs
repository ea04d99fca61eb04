//! Facts about the machine, and how much of it others took.

use std::fs;

use serde::{Deserialize, Serialize};

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

impl Host {
    /// Reads the facts; what cannot be read is said to be unknown.
    #[must_use]
    pub fn read() -> Self {
        let uname = rustix::system::uname();
        let text = |bytes: &std::ffi::CStr| bytes.to_string_lossy().into_owned();
        let version = text(uname.version());
        let cpuinfo = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let field = |name: &str| {
            cpuinfo
                .lines()
                .find(|line| line.starts_with(name))
                .and_then(|line| line.split_once(':'))
                .map(|(_, value)| value.trim().to_owned())
        };
        let preemption = ["PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT"].into_iter().find(|word| version.contains(word));
        Self {
            kernel: format!("{} {version}", text(uname.release())),
            preemption: preemption.unwrap_or("unknown").into(),
            cpu: field("model name").unwrap_or_else(|| "unknown".into()),
            cpus: cpuinfo.lines().filter(|line| line.starts_with("processor")).count() as u64,
            hypervisor: field("flags").is_some_and(|flags| flags.split(' ').any(|flag| flag == "hypervisor")),
            clock_source: read_word("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
            rt_runtime_us: read_word("/proc/sys/kernel/sched_rt_runtime_us").parse().unwrap_or(0),
        }
    }
}

fn read_word(path: &str) -> String {
    fs::read_to_string(path).map_or_else(|_| "unknown".into(), |text| text.trim().to_owned())
}

/// Time that the host took from this machine's processors, summed over them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Steal {
    /// Stolen [ms], in the kernel's resolution of 10 ms.
    pub stolen_ms: u64,
    /// Share of all processors' time [%].
    pub percent: f64,
}

/// Counters of /proc/stat at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CpuTimes {
    total: u64,
    stolen: u64,
}

/// The unit of /proc/stat [ms].
const JIFFY_MS: u64 = 10;

impl CpuTimes {
    /// Reads the counters.
    #[must_use]
    pub fn read() -> Self {
        Self::parse(&fs::read_to_string("/proc/stat").unwrap_or_default())
    }

    fn parse(stat: &str) -> Self {
        let fields: Vec<u64> = stat
            .lines()
            .next()
            .unwrap_or_default()
            .split_ascii_whitespace()
            .skip(1)
            .filter_map(|field| field.parse().ok())
            .collect();
        // user nice system idle iowait irq softirq steal; guest times are part of user.
        Self { total: fields.iter().take(8).sum(), stolen: fields.get(7).copied().unwrap_or(0) }
    }

    /// What was stolen since.
    #[must_use]
    pub fn steal_until(&self, later: &Self) -> Steal {
        let stolen = later.stolen.saturating_sub(self.stolen);
        let total = later.total.saturating_sub(self.total).max(1);
        Steal { stolen_ms: stolen * JIFFY_MS, percent: 100.0 * stolen as f64 / total as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steal_is_the_eighth_field() {
        let before = CpuTimes::parse("cpu  100 0 50 800 0 0 0 50 0 0\ncpu0 1 2 3\n");
        let after = CpuTimes::parse("cpu  150 0 60 880 0 0 0 60 7 0\n");
        assert_eq!(before.steal_until(&after), Steal { stolen_ms: 100, percent: 100.0 * 10.0 / 150.0 });
    }

    #[test]
    fn the_machine_is_known() {
        let host = Host::read();
        assert!(host.cpus >= 1 && !host.kernel.is_empty(), "{host:?}");
    }
}
