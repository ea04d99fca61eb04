//! Findings about load: CPU time taken by the host, and other programs on the loops' CPU.

use std::fs;

use crate::cpu_times::CpuTimes;
use crate::{Machine, cpu_list};
use report::finding::Finding;
use report::host::Steal;

/// Share of the time from which on figures say more about the host than about anything here [%].
pub const STEAL_MAX_PERCENT: f64 = 1.0;

const WHY: &str =
    "time that the host gave to other virtual machines, while a loop here wanted to run";
const FIX: &str = "ask whoever runs the host for processors of your own, or fly elsewhere";

#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![stolen(
        "steal since boot",
        &CpuTimes::default().steal_until(&CpuTimes::of(machine, None)),
    )]
}

/// What was stolen in a stretch of time.
#[must_use]
pub fn stolen(subject: &str, steal: &Steal) -> Finding {
    let found = format!(
        "{:.2} % of all processors' time ({} ms)",
        steal.percent, steal.stolen_ms
    );
    let finding = Finding::ok(subject, found, WHY);
    if steal.percent > STEAL_MAX_PERCENT {
        finding.softens(FIX)
    } else {
        finding
    }
}

/// How many programs the finding names.
const NAMED: usize = 5;

/// A process that was last scheduled on the loops' CPU and competes for it.
struct Competitor {
    name: String,
    pid: u32,
    is_realtime: bool,
}

/// Other programs on the loops' CPU: real-time processes, running ones, and those pinned to it.
#[must_use]
pub fn other_programs(machine: &Machine) -> Finding {
    let why =
        "a program on the loops' CPU delays their wake-ups and evicts their data from its caches";
    let cpu = machine.loops_cpu();
    let competitors = competitors(machine, cpu, std::process::id());
    if competitors.is_empty() {
        let found = format!("no other program runs on CPU {cpu}");
        return Finding::ok("other programs", found, why);
    }
    let mut names: Vec<String> = competitors
        .iter()
        .take(NAMED)
        .map(|it| {
            let class = if it.is_realtime { ", real-time" } else { "" };
            format!("{} ({}{class})", it.name, it.pid)
        })
        .collect();
    if competitors.len() > NAMED {
        names.push(format!("{} more", competitors.len() - NAMED));
    }
    let finding = Finding::ok(
        "other programs",
        format!("on CPU {cpu}: {}", names.join(", ")),
        why,
    );
    let fix =
        "end them or move them: taskset -cp CPUS PID; or choose another CPU for the loops: --cpu N";
    if competitors.iter().any(|it| it.is_realtime) {
        finding.softens(fix)
    } else {
        finding.could_be_better(fix)
    }
}

fn competitors(machine: &Machine, cpu: usize, own_pid: u32) -> Vec<Competitor> {
    let mut pids: Vec<u32> = fs::read_dir(machine.root.join("proc"))
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .filter(|pid| *pid != own_pid)
        .collect();
    pids.sort_unstable();
    pids.into_iter()
        .filter_map(|pid| competitor(machine, cpu, pid))
        .collect()
}

fn competitor(machine: &Machine, cpu: usize, pid: u32) -> Option<Competitor> {
    // Kernel threads have no command line.
    machine
        .read(&format!("/proc/{pid}/cmdline"))
        .filter(|line| !line.is_empty())?;
    let stat = machine.read(&format!("/proc/{pid}/stat"))?;
    // The name in parentheses may itself contain blanks and parentheses.
    let (head, tail) = stat.rsplit_once(')')?;
    let (_, name) = head.split_once('(')?;
    let fields: Vec<&str> = tail.split_whitespace().collect();
    // Fields 3 (state), 39 (CPU) and 41 (policy) of proc(5).
    let (state, last_cpu, policy) = (*fields.first()?, fields.get(36)?, fields.get(38)?);
    if last_cpu.parse() != Ok(cpu) {
        return None;
    }
    // SCHED_FIFO, SCHED_RR and SCHED_DEADLINE.
    let is_realtime = policy
        .parse()
        .is_ok_and(|policy: u32| matches!(policy, 1 | 2 | 6));
    let is_pinned = machine
        .field(&format!("/proc/{pid}/status"), "Cpus_allowed_list")
        .is_some_and(|list| cpu_list(&list) == [cpu]);
    let is_pinned = is_pinned && machine.allowed_cpus() != [cpu];
    (is_realtime || is_pinned || state == "R").then(|| Competitor {
        name: name.to_owned(),
        pid,
        is_realtime,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Answers;
    use report::finding::{Level, RealtimeClass};

    fn add(root: &std::path::Path, pid: u32, name: &str, (state, cpu, policy): (&str, u32, u32)) {
        let directory = root.join(format!("proc/{pid}"));
        fs::create_dir_all(&directory).unwrap();
        let between = "0 ".repeat(35);
        let stat = format!("{pid} ({name}) {state} {between}{cpu} 0 {policy} 0");
        fs::write(directory.join("stat"), stat).unwrap();
        fs::write(directory.join("cmdline"), name).unwrap();
        fs::write(directory.join("status"), "Cpus_allowed_list:\t0-3\n").unwrap();
    }

    #[test]
    fn programs_on_the_cpu_of_the_loops_are_named() {
        let root = tempfile::tempdir().unwrap();
        let answers = Answers {
            cpu: Some(3),
            ..Answers::default()
        };
        let machine = Machine::under(root.path(), answers);
        add(root.path(), 10, "asleep", ("S", 3, 0));
        add(root.path(), 11, "elsewhere", ("R", 2, 1));
        assert_eq!(other_programs(&machine).level, Level::Ok);
        add(root.path(), 12, "a (busy) one", ("R", 3, 0));
        let finding = other_programs(&machine);
        assert_eq!(finding.found, "on CPU 3: a (busy) one (12)");
        assert_eq!(
            (finding.level, finding.allows),
            (Level::Warning, RealtimeClass::Hard)
        );
        add(root.path(), 13, "ironbird", ("S", 3, 1));
        let finding = other_programs(&machine);
        assert_eq!(
            finding.found,
            "on CPU 3: a (busy) one (12), ironbird (13, real-time)"
        );
        assert_eq!(finding.allows, RealtimeClass::Soft);
        // A kernel thread.
        fs::write(root.path().join("proc/13/cmdline"), "").unwrap();
        assert_eq!(other_programs(&machine).allows, RealtimeClass::Hard);
    }
}
