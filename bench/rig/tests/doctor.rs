//! The doctor: what it finds on machines that are made up, and that this machine gets a verdict.

use crate::rig::{Ended, IRONBIRD, Rig, copy_executable, not_tested, table};
use host::doctor::{Examination, SCHEMA, examine};
use host::{Answers, Machine};
use ipc::instance::Instance;
use report::finding::{Finding, Level, RealtimeClass};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;

/// Files of a machine on which nothing is wrong: four processors, the last one isolated.
const FINE: &[(&str, &str)] = &[
    ("proc/sys/kernel/osrelease", "6.12.9-rt\n"),
    (
        "proc/sys/kernel/version",
        "#1 SMP PREEMPT_RT Debian 6.12.9-1\n",
    ),
    ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
    ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
    (
        "proc/self/status",
        "Name:\tironbird\nCpus_allowed_list:\t0-3\nCapEff:\t0000000000000000\n",
    ),
    ("proc/self/limits", LIMITS_RAISED),
    ("proc/self/cgroup", "0::/user.slice/session-1.scope\n"),
    ("proc/self/timerslack_ns", "50000\n"),
    (
        "proc/cpuinfo",
        "processor\t: 0\nmodel name\t: Some CPU\nflags\t\t: fpu constant_tsc nonstop_tsc\n",
    ),
    ("proc/stat", "cpu  1000 0 500 8000 0 0 0 0 0 0\n"),
    ("sys/devices/system/cpu/isolated", "3\n"),
    (
        "sys/devices/system/cpu/cpu3/topology/thread_siblings_list",
        "3\n",
    ),
    (
        "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
        "performance\n",
    ),
    (
        "sys/devices/system/clocksource/clocksource0/current_clocksource",
        "tsc\n",
    ),
    (
        "sys/devices/system/clocksource/clocksource0/available_clocksource",
        "tsc hpet acpi_pm \n",
    ),
];
const LIMITS_RAISED: &str = "Limit                     Soft Limit           Hard Limit           Units     \n\
    Max locked memory         unlimited            unlimited            bytes     \n\
    Max realtime priority     95                   95                             \n";
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

/// The examination of the fine machine with some of its files and answers changed; an empty file is none.
fn with(files: &[(&str, &str)], answers: Answers) -> Examination {
    let root = TempDir::new().unwrap();
    for (path, text) in FINE.iter().chain(files) {
        let path = root.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
        if text.is_empty() {
            fs::remove_file(&path).unwrap();
        }
    }
    examine(&Machine::under(root.path(), answers), None)
}

fn finding(examination: &Examination, subject: &str) -> Finding {
    let found = examination
        .findings
        .iter()
        .find(|finding| finding.subject == subject);
    found
        .unwrap_or_else(|| panic!("nothing about {subject}: {examination:?}"))
        .clone()
}

#[test]
fn a_machine_on_which_nothing_is_wrong_is_hard() {
    let examination = with(&[], fine_answers());
    assert_eq!(examination.diagnosis.verdict, RealtimeClass::Hard);
    assert_eq!(examination.diagnosis.reasons, Vec::<String>::new());
    for finding in &examination.findings {
        assert_eq!(
            (finding.level, &finding.fix),
            (Level::Ok, &None),
            "{finding:?}"
        );
    }
}

fn class(word: &str) -> RealtimeClass {
    serde_json::from_value(word.into()).unwrap()
}

#[test]
fn what_files_tell_is_found_with_its_weight_and_a_fix() {
    const NICE: &str = "Cpus_allowed_list:\t0-3\nCapEff:\t0000000000804000\n";
    for [file, content, subject, verdict, found, fix] in table(include_str!("doctor_findings.md")) {
        let content = match content {
            "LIMITS_DEFAULT" => LIMITS_DEFAULT.to_owned(),
            "none" => "\n".to_owned(),
            line => line.replace("\\n", "\n").replace("\\t", "\t"),
        };
        let (verdict, fix) = (class(verdict), &*fix.replace('¦', "|"));
        let examination = with(&[(file, &content)], fine_answers());
        let it = finding(&examination, subject);
        assert_eq!(it.allows, verdict, "{it:?}");
        let blocks = verdict == RealtimeClass::NotRealTime;
        assert_eq!(it.level == Level::Blocks, blocks, "{it:?}");
        assert_ne!(it.level, Level::Ok, "{it:?}");
        assert!(it.found.contains(found), "no `{found}`: {it:?}");
        assert!(
            it.fix.as_deref().unwrap_or_default().contains(fix),
            "no `{fix}`: {it:?}"
        );
        assert!(!it.why.is_empty());
        assert_eq!(examination.diagnosis.verdict, verdict);
        assert_eq!(
            examination.diagnosis.reasons.is_empty(),
            verdict == RealtimeClass::Hard,
            "{examination:?}"
        );
        assert!(
            examination
                .diagnosis
                .reasons
                .iter()
                .all(|reason| reason.starts_with(subject)),
            "{examination:?}"
        );
    }
    // Capabilities stand in for raised limits.
    let examination = with(
        &[
            ("proc/self/status", NICE),
            ("proc/self/limits", LIMITS_DEFAULT),
        ],
        fine_answers(),
    );
    assert_eq!(examination.diagnosis.verdict, RealtimeClass::Hard);
}

type Change = fn(&mut Answers);

#[test]
fn what_the_system_answers_is_found_too() {
    let of = |change: Change, subject: &str| {
        let mut answers = fine_answers();
        change(&mut answers);
        let examination = with(&[], answers);
        (
            finding(&examination, subject),
            examination.diagnosis.verdict,
        )
    };
    use RealtimeClass::{Hard, NotRealTime};
    let leftovers: Change = |it| it.leftovers = vec![PathBuf::from("/dev/shm/x"); 3];
    let cases: [(Change, &str, RealtimeClass, &str); 7] = [
        (
            |it| it.fifo_errno = Some(EPERM),
            "scheduling",
            NotRealTime,
            "setcap cap_sys_nice,cap_ipc_lock+ep '/",
        ),
        (
            |it| it.deep_sleep_errno = Some(EACCES),
            "deep sleep",
            Hard,
            "KERNEL==\"cpu_dma_latency\"",
        ),
        (
            |it| it.timer_resolution_ns = 4_000_000,
            "timers",
            NotRealTime,
            "CONFIG_HIGH_RES_TIMERS=y",
        ),
        (
            |it| it.shared_memory_free_bytes = Some(1 << 20),
            "shared memory",
            NotRealTime,
            "remount,size=256M",
        ),
        (
            |it| it.shared_memory_free_bytes = None,
            "shared memory",
            NotRealTime,
            "mount -t tmpfs",
        ),
        (leftovers, "leftovers", Hard, "ironbird clean"),
        (|it| it.cpu = Some(1), "isolation", Hard, "--cpu 3"),
    ];
    for (change, subject, verdict, fix) in cases {
        let (it, overall) = of(change, subject);
        assert_eq!((it.allows, overall), (verdict, verdict), "{it:?}");
        assert!(
            it.fix.as_deref().unwrap_or_default().contains(fix),
            "no `{fix}`: {it:?}"
        );
    }
    let (leftovers, _) = of(leftovers, "leftovers");
    assert_eq!(leftovers.found, "/dev/shm/x and 2 more");
}

#[test]
fn a_cgroup_without_real_time_is_named_with_the_file_that_changes_it() {
    let group = "sys/fs/cgroup/cpu,cpuacct/jobs/cpu.rt_runtime_us";
    let files = [
        ("proc/self/cgroup", "4:cpu,cpuacct:/jobs\n0::/\n"),
        (group, "0\n"),
    ];
    let it = finding(&with(&files, fine_answers()), "rt cgroup");
    assert_eq!(it.level, Level::Blocks);
    assert!(
        it.fix
            .as_deref()
            .unwrap_or_default()
            .contains(&format!("tee /{group}")),
        "{it:?}"
    );
    let it = finding(
        &with(&[files[0], (group, "400000\n")], fine_answers()),
        "rt cgroup",
    );
    assert_eq!(
        (it.level, it.found.as_str()),
        (Level::Ok, "/jobs has 400000 us of real time a period")
    );

    // In the unified hierarchy nothing but the refusal shows it, and only to those who may have SCHED_FIFO.
    let privileged = [(
        "proc/self/status",
        "Cpus_allowed_list:\t0-3\nCapEff:\t00000000ffffffff\n",
    )];
    let refused = Answers {
        fifo_errno: Some(EPERM),
        ..fine_answers()
    };
    let it = finding(&with(&privileged, refused.clone()), "rt cgroup");
    assert_eq!(it.level, Level::Blocks);
    assert!(it.found.contains("/user.slice/session-1.scope"), "{it:?}");
    assert_eq!(finding(&with(&[], refused), "rt cgroup").level, Level::Ok);
}

/// Examines all instances below the root path, and not one of the rig's.
fn doctor(rig: &Rig, args: &[&str]) -> Ended {
    let mut command = Command::new(IRONBIRD);
    command
        .arg("doctor")
        .args(args)
        .env("IRONBIRD_ROOT", rig.root());
    rig.launch(command).end()
}

#[test]
fn this_machine_gets_a_verdict_that_follows_from_what_is_shown() {
    let rig = Rig::new("doctor");
    let ended = doctor(&rig, &["--seconds", "0.3", "--json"]);
    let examination: Examination = serde_json::from_str(&ended.stdout).unwrap();
    assert_eq!(examination.schema, SCHEMA);
    let worst = examination
        .findings
        .iter()
        .map(|finding| finding.allows)
        .min()
        .unwrap();
    assert_eq!(examination.diagnosis.verdict, worst);
    ended.expect(if worst == RealtimeClass::NotRealTime {
        3
    } else {
        0
    });
    let measured = examination.measured.unwrap();
    assert_eq!(measured.timer.statistics.count, 300);
    assert_eq!(
        measured.ring.statistics.count + measured.ring.ticks_skipped,
        300
    );
    let granted = examination
        .findings
        .iter()
        .any(|it| it.subject == "scheduling" && it.level == Level::Ok);
    assert_eq!(
        granted,
        measured.scheduling.starts_with("SCHED_FIFO"),
        "{}",
        measured.scheduling
    );
    assert_eq!(
        granted,
        measured.refused.is_empty(),
        "{:?}",
        measured.refused
    );
}

#[test]
fn leftovers_of_a_killed_flight_are_found_and_gone_after_a_clean_up() {
    let rig = Rig::new("left");
    Instance::under(&rig.root(), "killed")
        .unwrap()
        .prepare()
        .unwrap();
    fs::create_dir(rig.root().join("mine")).unwrap();
    let ended = doctor(&rig, &["--seconds", "0.05"])
        .says("ironbird clean")
        .says("VERDICT ")
        .says("Measured for 0.05 s each");
    assert!(
        ended
            .stdout
            .contains(rig.root().join("killed").to_str().unwrap()),
        "{ended}"
    );
    rig.ok("clean");
    assert!(
        !doctor(&rig, &["--seconds", "0.05"])
            .stdout
            .contains("ironbird clean"),
        "a directory of somebody else's is no leftover"
    );
}

#[test]
fn a_user_without_rights_is_told_what_is_refused_and_how_to_get_it() {
    let rig = Rig::new("rights");
    if !rustix::process::geteuid().is_root() {
        not_tested("only root can become a user without rights");
        return;
    }
    const NOBODY: u32 = 65_534;
    // The test's own executable may lie where only its owner may look.
    let (home, executable) = (rig.path(""), rig.path("ironbird"));
    fs::set_permissions(&home, fs::Permissions::from_mode(0o755)).unwrap();
    copy_executable(&executable);
    let mut command = Command::new(&executable);
    command
        .args(["doctor", "--seconds", "0.05"])
        .env("IRONBIRD_ROOT", rig.path("nobody"))
        .uid(NOBODY)
        .gid(NOBODY);
    let rtprio = rustix::process::getrlimit(rustix::process::Resource::Rtprio);
    if rtprio.current.is_none_or(|limit| limit > 0) {
        not_tested(&format!(
            "whoever root becomes here may use SCHED_FIFO: {rtprio:?}"
        ));
        return;
    }
    let ended = rig.launch(command).end().expect(3);
    ended
        .says("VERDICT not real-time here")
        .says("SCHED_FIFO refused")
        .says("limits.d")
        .says("\n  without root the same laws fly in lockstep (--pace lockstep), in slow motion (flight.slowdown), and in")
        .says("SCHED_OTHER on processor");
}
