//! The finding about other programs on the loops' CPU: real-time processes, running ones, and those pinned to it.

use std::fs;

use crate::sampler::Stat;
use crate::{Machine, cpu_list};
use analysis::finding::Finding;

const NAMED: usize = 5;

/// A process that was last scheduled on the loops' CPU and competes for it.
struct Competitor {
    name: String,
    is_realtime: bool,
}

pub(super) fn finding(machine: &Machine) -> Finding {
    let ok = |found: String| {
        let why = "a program on the loops' CPU delays their wake-ups and evicts their data from its caches";
        Finding::ok("other programs", found, why)
    };
    let cpu = machine.loops_cpu();
    let processes = fs::read_dir(machine.root.join("proc"))
        .into_iter()
        .flatten();
    let mut pids: Vec<u32> = processes
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .filter(|pid| *pid != std::process::id())
        .collect();
    pids.sort_unstable();
    let competitors = pids
        .into_iter()
        .filter_map(|it| competitor(machine, cpu, it));
    let competitors: Vec<Competitor> = competitors.collect();
    if competitors.is_empty() {
        return ok(format!("no other program runs on CPU {cpu}"));
    }
    let mut names: Vec<_> = competitors.iter().map(|it| it.name.clone()).collect();
    if let Some(more) = names.len().checked_sub(NAMED).filter(|more| *more > 0) {
        names.truncate(NAMED);
        names.push(format!("{more} more"));
    }
    let finding = ok(format!("on CPU {cpu}: {}", names.join(", ")));
    let fix =
        "end them or move them: taskset -cp CPUS PID; or choose another CPU for the loops: --cpu N";
    if competitors.iter().any(|it| it.is_realtime) {
        finding.softens(fix)
    } else {
        finding.could_be_better(fix)
    }
}

fn competitor(machine: &Machine, cpu: usize, pid: u32) -> Option<Competitor> {
    // Kernel threads have no command line.
    machine
        .read(&format!("/proc/{pid}/cmdline"))
        .filter(|line| !line.is_empty())?;
    let line = machine.read(&format!("/proc/{pid}/stat"))?;
    let (_, name) = line.rsplit_once(')')?.0.split_once('(')?;
    let stat = Stat::of(&line);
    // Fields 39 (CPU) and 41 (policy) of proc(5).
    if stat.number(39) != cpu as u64 {
        return None;
    }
    // SCHED_FIFO, SCHED_RR and SCHED_DEADLINE.
    let is_realtime = matches!(stat.number(41), 1 | 2 | 6);
    let is_pinned = machine
        .field(&format!("/proc/{pid}/status"), "Cpus_allowed_list")
        .is_some_and(|list| cpu_list(&list) == [cpu] && machine.allowed_cpus() != [cpu]);
    let class = if is_realtime { ", real-time" } else { "" };
    (is_realtime || is_pinned || stat.state() == Some('R')).then(|| Competitor {
        name: format!("{name} ({pid}{class})"),
        is_realtime,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Answers;
    use analysis::finding::{Level, RealtimeClass};

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
        assert_eq!(finding(&machine).level, Level::Ok);
        add(root.path(), 12, "a (busy) one", ("R", 3, 0));
        let busy = finding(&machine);
        assert_eq!(busy.found, "on CPU 3: a (busy) one (12)");
        assert_eq!(
            (busy.level, busy.allows),
            (Level::Warning, RealtimeClass::Hard)
        );
        add(root.path(), 13, "ironbird", ("S", 3, 1));
        let realtime = finding(&machine);
        let expected = "on CPU 3: a (busy) one (12), ironbird (13, real-time)";
        assert_eq!(
            (&*realtime.found, realtime.allows),
            (expected, RealtimeClass::Soft)
        );
        // A kernel thread.
        fs::write(root.path().join("proc/13/cmdline"), "").unwrap();
        assert_eq!(finding(&machine).allows, RealtimeClass::Hard);
    }
}
