//! Machine facts for a report, and how much processor time others took.

use analysis::host::{Host, Steal};
use analysis::observations::JIFFY_NS;

use crate::machine::{Machine, RT_RUNTIME};

pub fn host() -> Host {
    host_of(&Machine::files())
}

/// The name of this machine in the network.
pub fn hostname() -> String {
    let name = Machine::files().read("/proc/sys/kernel/hostname");
    name.unwrap_or_else(|| "unknown".into())
}

/// The facts of a machine; what cannot be read is said to be unknown.
pub fn host_of(machine: &Machine) -> Host {
    let unknown = || "unknown".into();
    let word = |path| machine.read(path).unwrap_or_else(unknown);
    let cpuinfo = machine.read("/proc/cpuinfo").unwrap_or_default();
    Host {
        kernel: format!(
            "{} {}",
            word("/proc/sys/kernel/osrelease"),
            word("/proc/sys/kernel/version")
        ),
        preemption: machine.preemption().into(),
        cpu: machine
            .field("/proc/cpuinfo", "model name")
            .unwrap_or_else(unknown),
        cpus: cpuinfo
            .lines()
            .filter(|line| line.starts_with("processor"))
            .count() as u64,
        hypervisor: machine.hypervisor(),
        clock_source: machine.clock_source(),
        rt_runtime_us: machine.number(RT_RUNTIME).unwrap_or(0),
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CpuTimes {
    /// The processor; none where it is all of them together.
    processor: Option<u64>,
    total: u64,
    /// Time stolen since the machine was started, in the unit of /proc/stat.
    pub stolen: u64,
}

const JIFFY_MS: u64 = JIFFY_NS / 1_000_000;

impl CpuTimes {
    pub fn read(processor: Option<u64>) -> Self {
        Self::of(&Machine::files(), processor)
    }

    /// Counters of one processor of a machine, or of all of them, which count since it was started.
    pub fn of(machine: &Machine, processor: Option<u64>) -> Self {
        let stat = machine.read("/proc/stat").unwrap_or_default();
        let name = processor.map_or_else(|| "cpu ".into(), |number| format!("cpu{number} "));
        let fields: Vec<u64> = stat
            .lines()
            .find(|line| line.starts_with(&name))
            .unwrap_or_default()
            .split_ascii_whitespace()
            .skip(1)
            .filter_map(|field| field.parse().ok())
            .collect();
        // user nice system idle iowait irq softirq steal; guest times are part of user.
        let total = fields.iter().take(8).sum();
        let stolen = fields.get(7).copied().unwrap_or(0);
        Self {
            processor,
            total,
            stolen,
        }
    }

    pub fn steal_until(&self, later: &Self) -> Steal {
        let stolen = later.stolen.saturating_sub(self.stolen);
        let total = later.total.saturating_sub(self.total);
        Steal {
            stolen_ms: stolen * JIFFY_MS,
            percent: 100.0 * stolen as f64 / total.max(1) as f64,
            of_ms: total * JIFFY_MS,
            processor: later.processor,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::made_up;

    fn times(stat: &str, processor: Option<u64>) -> CpuTimes {
        let (_root, machine) = made_up(&[("proc/stat", stat)]);
        CpuTimes::of(&machine, processor)
    }

    #[test]
    fn steal_is_the_eighth_field_of_the_processors_line() {
        let before = times("cpu  100 0 50 800 0 0 0 50 0 0\ncpu0 1 2 3\n", None);
        let after = times("cpu  150 0 60 880 0 0 0 60 7 0\n", None);
        let steal = before.steal_until(&after);
        assert_eq!((steal.stolen_ms, steal.of_ms), (100, 1500));
        assert_eq!(
            (steal.percent, steal.processor),
            (100.0 * 10.0 / 150.0, None)
        );
        assert_eq!(after.steal_until(&after).of_ms, 0);
        let stat =
            "cpu  1 0 1 8 0 0 0 5 0 0\ncpu1 1 0 1 8 0 0 0 2 0 0\ncpu10 1 0 1 8 0 0 0 3 0 0\n";
        let stolen = [None, Some(1), Some(10), Some(7)].map(|it| times(stat, it).stolen);
        assert_eq!(stolen, [5, 2, 3, 0]);
    }
}
