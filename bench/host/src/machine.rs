//! Reads the files of the machine, and keeps the answers of its system calls.

use std::fs;
use std::path::{Path, PathBuf};

use ipc::instance::{Instance, shared_memory_space};
use process::rt::{fifo_refusal, hold_cpu_latency};
use rustix::thread::ClockId;
use rustix::time::clock_getres;

#[derive(Clone, Debug)]
pub struct Machine {
    pub(crate) root: PathBuf,
    pub answers: Answers,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Answers {
    /// Error number with which SCHED_FIFO at the highest priority of the loops is refused.
    pub fifo_errno: Option<i32>,
    /// Error number with which /dev/cpu_dma_latency cannot be held.
    pub deep_sleep_errno: Option<i32>,
    pub timer_resolution_ns: u64,
    pub shared_memory_free_bytes: Option<u64>,
    pub leftovers: Vec<PathBuf>,
    pub cpu: Option<usize>,
}

impl Machine {
    /// This machine, with the loops on processor `cpu` or on the default one; SCHED_FIFO is tried at
    /// `fifo_priority`, on a thread that ends at once.
    pub fn here(fifo_priority: i32, cpu: Option<usize>) -> Self {
        let resolution = clock_getres(ClockId::Monotonic);
        let errno = |e: std::io::Error| e.raw_os_error().unwrap_or(0);
        let answers = Answers {
            fifo_errno: fifo_refusal(fifo_priority).map(errno),
            deep_sleep_errno: hold_cpu_latency().err().map(errno),
            timer_resolution_ns: resolution.tv_sec.unsigned_abs() * 1_000_000_000
                + resolution.tv_nsec.unsigned_abs(),
            shared_memory_free_bytes: shared_memory_space().ok(),
            leftovers: Instance::known()
                .iter()
                .flat_map(Instance::leftovers)
                .collect(),
            cpu,
        };
        Self::under(Path::new("/"), answers)
    }

    /// This machine as far as files describe it, without system calls.
    pub fn files() -> Self {
        Self::under(Path::new("/"), Answers::default())
    }

    pub fn under(root: &Path, answers: Answers) -> Self {
        Self {
            root: root.to_owned(),
            answers,
        }
    }

    /// A file's text without the blanks around it; nothing where it cannot be read.
    pub fn read(&self, path: &str) -> Option<String> {
        fs::read_to_string(self.root.join(path.trim_start_matches('/')))
            .ok()
            .map(|text| text.trim().to_owned())
    }

    pub fn number(&self, path: &str) -> Option<i64> {
        self.read(path)?.parse().ok()
    }

    /// The value after `name` and a colon in a file of such lines, the first one.
    pub fn field(&self, path: &str, name: &str) -> Option<String> {
        let text = self.read(path)?;
        text.lines().find_map(|line| {
            let (key, value) = line.split_once(':')?;
            (key.trim() == name).then(|| value.trim().to_owned())
        })
    }

    pub fn allowed_cpus(&self) -> Vec<usize> {
        self.field("/proc/self/status", "Cpus_allowed_list")
            .map(|list| cpu_list(&list))
            .unwrap_or_default()
    }

    /// The processor of the loops: the one named, or the highest-numbered one allowed.
    pub fn loops_cpu(&self) -> usize {
        self.answers
            .cpu
            .or_else(|| self.allowed_cpus().last().copied())
            .unwrap_or(0)
    }

    pub fn has_capability(&self, number: u32) -> bool {
        self.field("/proc/self/status", "CapEff")
            .and_then(|hex| u64::from_str_radix(&hex, 16).ok())
            .is_some_and(|set| set >> number & 1 == 1)
    }

    /// A soft limit of this process as the kernel names it, such as `Max locked memory`; nothing stands for unlimited.
    pub fn limit(&self, name: &str) -> Option<u64> {
        let text = self.read("/proc/self/limits")?;
        text.lines()
            .find_map(|line| line.strip_prefix(name))?
            .split_whitespace()
            .next()?
            .parse()
            .ok()
    }

    pub fn preemption(&self) -> &'static str {
        let version = self.read("/proc/sys/kernel/version").unwrap_or_default();
        if self.read("/sys/kernel/realtime").as_deref() == Some("1") {
            return "PREEMPT_RT";
        }
        ["PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT"]
            .into_iter()
            .find(|word| version.split([' ', '(']).any(|part| part == *word))
            .unwrap_or("unknown")
    }

    /// The preemption model chosen at boot, if the kernel reports it.
    pub fn preemption_chosen(&self) -> Option<String> {
        let choices = self.read("/sys/kernel/debug/sched/preempt");
        let marked = choices
            .as_deref()
            .and_then(|text| text.split_once('(')?.1.split_once(')'))
            .map(|(name, _)| name);
        let command_line = self.read("/proc/cmdline").unwrap_or_default();
        let requested = command_line
            .split_whitespace()
            .find_map(|word| word.strip_prefix("preempt="));
        marked.or(requested).map(str::to_owned)
    }

    pub fn clock_source(&self) -> String {
        self.read(CLOCK_SOURCE).unwrap_or_else(|| "unknown".into())
    }
}

pub const CLOCK_SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
/// The file of the real-time throttle: what SCHED_FIFO gets of each period [us]; -1 is all.
pub const RT_RUNTIME: &str = "/proc/sys/kernel/sched_rt_runtime_us";

/// The numbers of a list as the kernel writes it: `0-2,5`. Entries that are not numbers are skipped.
pub fn cpu_list(text: &str) -> Vec<usize> {
    let mut cpus: Vec<usize> = text
        .trim()
        .split(',')
        .filter_map(|part| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            Some(first.trim().parse().ok()?..=last.trim().parse().ok()?)
        })
        .flatten()
        .collect();
    cpus.sort_unstable();
    cpus
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A machine with these files, which go with the directory.
    pub(crate) fn made_up(files: &[(&str, &str)]) -> (tempfile::TempDir, Machine) {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let machine = Machine::under(root.path(), Answers::default());
        (root, machine)
    }
}
