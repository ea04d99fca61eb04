//! The doctor: what it finds on machines that are made up.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use analysis::finding::{Finding, Level, RealtimeClass};
use host::doctor::{Examination, examine};
use host::{Answers, Machine};
use std::fs;
use tempfile::TempDir;

/// Limits of an ordinary user.
const LIMITS_DEFAULT: &str = "Limit                     Soft Limit           Hard Limit           Units     \n\
    Max locked memory         8388608              8388608              bytes     \n\
    Max realtime priority     0                    0                              \n";
const EPERM: i32 = 1;
const EACCES: i32 = 13;

fn fine_answers() -> Answers {
    Answers {
        timer_resolution_ns: 1,
        shared_memory_free_bytes: Some(1 << 30),
        ..Answers::default()
    }
}

/// The rows of the first table of a Markdown page.
fn table<const COLUMNS: usize>(page: &'static str) -> Vec<[&'static str; COLUMNS]> {
    let (_, table) = page.split_once("|---|").unwrap();
    let rows = table.lines().skip(1).filter(|line| !line.is_empty());
    let cells = |line: &'static str| {
        let line = line.strip_prefix('|').unwrap().strip_suffix('|').unwrap();
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        cells.try_into().expect(line)
    };
    rows.map(cells).collect()
}

/// A cell of a table that stands for lines.
fn unescaped(cell: &str) -> String {
    cell.replace("\\n", "\n").replace("\\t", "\t")
}

/// The fine machine with some of its files and answers changed.
fn machine(files: &[(&str, &str)], answers: Answers) -> (TempDir, Machine) {
    let root = TempDir::new().unwrap();
    let write = |path: &str, text: &str| {
        let path = root.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
    };
    for [path, text] in table(include_str!("doctor_machine.md")) {
        write(path, &unescaped(text));
    }
    files.iter().for_each(|(path, text)| write(path, text));
    let machine = Machine::under(root.path(), answers);
    (root, machine)
}

fn with(files: &[(&str, &str)], answers: Answers) -> Examination {
    examine(&machine(files, answers).1, None, Vec::new())
}

#[test]
fn what_limits_cost_is_counted_in_all_groups_of_both_versions() {
    let (_root, machine) = machine(&[], fine_answers());
    let [cpu, memory] = ["cpu", "memory"].map(|it| machine.group_counters("self", it));
    assert_eq!(machine.throttled(&cpu), [1 + 2 + 4, 5 + 70 + 800]);
    assert_eq!(machine.counted(&memory, ["oom_kill"]), [1 + 2]);
}

fn finding<'a>(examination: &'a Examination, subject: &str) -> &'a Finding {
    let mut findings = examination.findings.iter();
    let found = findings.find(|finding| finding.subject == subject);
    found.unwrap_or_else(|| panic!("nothing about {subject}: {examination:?}"))
}

/// Demands a finding, its weight and its fix, and the verdict that follows.
fn assert_found(examination: &Examination, subject: &str, verdict: RealtimeClass, fix: &str) {
    let it = finding(examination, subject);
    let blocks = verdict == RealtimeClass::NotRealTime;
    let level = if blocks {
        Level::Blocks
    } else {
        Level::Warning
    };
    assert_eq!(
        (it.allows, examination.diagnosis.verdict),
        (verdict, verdict)
    );
    assert_eq!(it.level, level, "{it:?}");
    assert!(
        it.fix.as_deref().unwrap().contains(fix),
        "no `{fix}`: {it:?}"
    );
    assert!(!it.why.is_empty());
    let reasons = &examination.diagnosis.reasons;
    assert_eq!(reasons.is_empty(), verdict == RealtimeClass::Hard);
    assert!(
        reasons.iter().all(|it| it.starts_with(subject)),
        "{reasons:?}"
    );
}

#[test]
fn a_machine_on_which_nothing_is_wrong_is_hard() {
    let examination = with(&[], fine_answers());
    assert_eq!(examination.diagnosis.verdict, RealtimeClass::Hard);
    assert!(examination.diagnosis.reasons.is_empty());
    for it in &examination.findings {
        assert_eq!((it.level, &it.fix), (Level::Ok, &None), "{it:?}");
    }
    // Capabilities replace raised limits.
    let nice = "Cpus_allowed_list:\t0-3\nCapEff:\t0000000000804000\n";
    let files = [
        ("proc/self/status", nice),
        ("proc/self/limits", LIMITS_DEFAULT),
    ];
    let examination = with(&files, fine_answers());
    assert_eq!(examination.diagnosis.verdict, RealtimeClass::Hard);
}

#[test]
fn what_files_and_the_system_show_is_found_with_its_weight_and_a_fix() {
    for [file, content, subject, verdict, found, fix] in table(include_str!("doctor_findings.md")) {
        let content = match content {
            "LIMITS_DEFAULT" => LIMITS_DEFAULT.to_owned(),
            "none" => "\n".to_owned(),
            line => unescaped(line),
        };
        let verdict = serde_json::from_value(verdict.into()).unwrap();
        let (mut answers, mut files) = (fine_answers(), Vec::new());
        match file {
            "fifo_errno" => answers.fifo_errno = Some(EPERM),
            "deep_sleep_errno" => answers.deep_sleep_errno = Some(EACCES),
            "timer_resolution_ns" => answers.timer_resolution_ns = content.parse().unwrap(),
            "shared_memory_free_bytes" => answers.shared_memory_free_bytes = content.parse().ok(),
            "leftovers" => answers.leftovers = vec![content.into(); 3],
            "cpu" => answers.cpu = content.parse().ok(),
            file => files.push((file, &*content)),
        }
        let examination = with(&files, answers);
        assert_found(&examination, subject, verdict, &fix.replace('¦', "|"));
        let it = finding(&examination, subject);
        assert!(it.found.contains(found), "no `{found}`: {it:?}");
    }
}

#[test]
fn an_examination_is_printed_with_reasons_and_fixes() {
    let answers = Answers {
        fifo_errno: Some(EPERM),
        deep_sleep_errno: Some(EACCES),
        ..fine_answers()
    };
    let files = [
        ("proc/sys/kernel/version", "#1 SMP"),
        ("proc/cpuinfo", ""),
        ("sys/fs/cgroup/user.slice/cpu.max", "50000 100000\n"),
    ];
    let examination = with(&files, answers);
    let executable = std::env::current_exe().unwrap().display().to_string();
    let text = host::doctor::render(&examination).replace(&executable, "EXECUTABLE");
    insta::assert_snapshot!(text);
}
