//! How flights end: signals, closed terminals, dead supervisors, leftovers, limits; and what processes hold when they end.

use crate::fault_matrix::{await_gone, demand_interrupted};
use crate::rig::{Args, IRONBIRD, Rig, Running, is_gone, lacks_tool, not_tested, send, wait_until};
use ipc::Wire;
use messages::blackboards::{RUN, Run, RunPhase};
use process::rt::fifo_refusal;
use rustix::process::Signal;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;
use std::time::{Duration, Instant};

/// A long flight in slow motion, in the air; nothing in these tests depends on its deadlines.
fn in_the_air(rig: &Rig) -> Running {
    rig.take_off(format!("--rt off --config {} --duration 60s", rig.slow(20)))
}

#[test]
fn a_second_signal_ends_at_once_what_the_first_one_cannot() {
    let rig = Rig::new("stubborn");
    let mut flight = in_the_air(&rig);
    // The recorder's first report is there, so that there is something to print.
    rig.await_report();
    let roles = flight.roles();
    send(roles["record"], Signal::STOP);
    flight.signal(Signal::INT);
    await_gone(["plant", "outer", "inner", "mixer"].map(|role| roles[role]));
    assert!(
        flight.is_running(),
        "it waits for the recorder, which is stopped"
    );
    let second = Instant::now();
    flight.signal(Signal::INT);
    let ended = flight.end().expect(130);
    assert!(
        second.elapsed() < Duration::from_secs(4),
        "the launcher's own patience is 5 s: {:?}",
        second.elapsed()
    );
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    let report = rig.report();
    assert_eq!(
        (&report["verdict"]["status"], &report["run"]["in_flight"]),
        (&"INTERRUPTED".into(), &false.into())
    );
    assert!(is_gone(roles["record"]));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_is_over_before_the_recorder_looks_is_reported_whole() {
    let rig = Rig::new("over");
    let flight = rig.start(
        "fly",
        format!("--rt off --config {} --duration 50ms", rig.slow(5)),
    );
    let roles = flight.roles();
    let wire = Wire::open(&rig.known()).unwrap();
    // From then on nobody waits for the recorder, which has armed.
    wait_until("the plant to keep to its t_0", || {
        let board = wire.blackboard_reader::<Run>(RUN).unwrap()?;
        (board.get().phase() == RunPhase::Flying).then_some(())
    });
    send(roles["record"], Signal::STOP);
    await_gone(["plant", "outer", "inner", "mixer"].map(|role| roles[role]));
    drop(wire);
    send(roles["record"], Signal::CONT);
    flight.end().expect(0);
    let report = rig.report();
    for role in ["plant", "outer", "inner", "mixer"] {
        let said = &report["roles"][role];
        assert!(
            said["landed"] == true && said["ticks_run"].as_u64().unwrap() > 0,
            "{role}: {report}"
        );
    }
    assert_eq!(report["ticks"]["identity_holds"], true, "{report}");
    rig.assert_nothing_left();
}

/// Kills a flight with all its processes, none of which can say a last word.
pub(crate) fn kill_all(flight: Running) {
    let roles = flight.roles();
    // A stopped process does not act on its launcher's death.
    roles.values().for_each(|pid| send(*pid, Signal::STOP));
    flight.signal(Signal::KILL);
    flight.end();
    roles.values().for_each(|pid| send(*pid, Signal::KILL));
    await_gone(roles.into_values());
}

#[test]
fn clean_removes_and_names_what_killed_processes_left() {
    let rig = Rig::new("leftovers");
    kill_all(in_the_air(&rig));
    let left = rig.segments();
    assert!(!left.is_empty(), "killed processes cannot clean up");
    let other = Rig::new("bystander");
    let bystander = other.start("plant", "--rt off");
    bystander.await_words("waiting for");
    let directory = rig.root().join(&rig.instance);
    let allow =
        |mode: u32| fs::set_permissions(&directory, fs::Permissions::from_mode(mode)).unwrap();
    allow(0o770);
    let kept = format!(
        "kept the shared memory of instance `{}`: {} is not used",
        rig.instance,
        directory.display()
    );
    rig.ok("clean").says(&kept);
    allow(0o700);
    let mut clean = rig.ok("clean");
    for segment in left {
        clean = clean.says(&format!("removed /dev/shm/{segment}\n"));
    }
    clean.says(&format!("removed {}\n", directory.display()));
    rig.assert_nothing_left();
    other
        .ok("clean")
        .says(&format!("instance `{}` is alive", other.instance));
    assert!(
        !other.segments().is_empty(),
        "a living instance keeps its own"
    );
    bystander.signal(Signal::TERM);
    bystander.end().expect(130);
}

const ROLES: [&str; 5] = ["plant", "outer", "inner", "mixer", "record"];
/// A flight that lasts until it is ended; nothing in these tests depends on its deadlines.
const LONG: &str = "--rt off --duration 600s";

/// A command in a terminal of its own, which SIGUSR1 closes; none where there is no python3.
fn in_a_terminal(rig: &Rig, prefix: &[&str], command: &str, args: impl Args) -> Option<Running> {
    if !has_python() {
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig/closed_terminal.py");
    let program = [&["python3", script], prefix].concat();
    Some(rig.launch(rig.command_by(&program, command, args)))
}

fn has_python() -> bool {
    let version = Command::new("python3").arg("--version").output();
    let is_there = version.is_ok_and(|output| output.status.success());
    if !is_there {
        lacks_tool("there is no python3");
    }
    is_there
}

#[test]
fn a_role_takes_its_launchers_death_for_one_however_often_it_is_told() {
    let rig = Rig::new("told");
    let flight = rig.take_off(LONG);
    for pid in flight.roles().into_values() {
        for _ in 0..3 {
            send(pid, Signal::TERM);
        }
    }
    flight.end().expect(130);
    demand_interrupted(&rig, "each role was told three times");
    rig.assert_nothing_left();
}

#[test]
fn nohup_is_respected() {
    let rig = Rig::new("nohup");
    let nohup = ["env", "--ignore-signal=HUP"];
    let flight = rig.launch(rig.command_by(&nohup, "fly", "--rt off --duration 2s"));
    rig.await_flight();
    flight.signal(Signal::HUP);
    let result = flight.end().expect(0).result();
    assert_eq!(
        (result["status"].as_str(), result["ticks"].is_empty()),
        ("PASS", false)
    );
    assert_eq!(rig.report()["run"]["ending"], "completed");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_closed_terminal_ends_a_flight_with_a_dashboard_in_order() {
    let rig = Rig::new("hangup");
    let args = format!("{LONG} --watch");
    let Some(terminal) = in_a_terminal(&rig, &[], "fly", args) else {
        return;
    };
    rig.await_flight();
    terminal.await_output("position error, last");
    let commands = ROLES.iter().chain(&["fly", "watch"]);
    let processes: Vec<u32> = commands.flat_map(|it| rig.processes_of(it)).collect();
    assert_eq!(processes.len(), 7, "{processes:?}");
    terminal.signal(Signal::USR1);
    terminal.end().says("\nended 130 ");
    await_gone(processes);
    demand_interrupted(&rig, "terminal closed");
    rig.assert_nothing_left();
}

#[test]
fn a_dashboard_whose_terminal_is_closed_ends_though_it_hears_of_no_hangup() {
    for ignored in ["--ignore-signal=HUP", "--default-signal=HUP"] {
        let rig = Rig::new("gone");
        let Some(terminal) = in_a_terminal(&rig, &["env", ignored], "watch", "") else {
            return;
        };
        terminal.await_output("\u{1b}[?1049h");
        let [watcher] = rig.processes_of("watch")[..] else {
            panic!("one dashboard")
        };
        terminal.signal(Signal::USR1);
        let ended = terminal.end();
        assert!(ended.stdout.contains("\nended 130 "), "{ignored}: {ended}");
        await_gone(vec![watcher]);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_dashboard_leaves_a_sane_terminal() {
    for signal in [Signal::KILL, Signal::HUP, Signal::QUIT] {
        let rig = Rig::new("sane");
        // A busy machine may let it fall: not to a ground.
        let config = crate::restarts::in_the_air(&rig, 1);
        let flight = format!("--rt off --duration 6s --trajectory hover --watch --config {config}");
        let Some(terminal) = in_a_terminal(&rig, &[], "fly", flight) else {
            return;
        };
        terminal.await_output("position error, last");
        let [watcher] = rig.processes_of("watch")[..] else {
            panic!("one dashboard")
        };
        send(watcher, signal);
        // The launcher has its terminal back, with its own line.
        terminal.await_output(" of 6.0 s   missed");
        let ended = terminal.end();
        assert!(
            ended.stdout.contains("\nended 0 icanon True\n"),
            "{signal:?}: {ended}"
        );
        let (left, entered) = (
            ended.stdout.rfind("\u{1b}[?1049l"),
            ended.stdout.rfind("\u{1b}[?1049h"),
        );
        assert!(
            entered.is_some() && left > entered,
            "{signal:?}: the alternate screen is left: {ended}"
        );
        assert!(
            ended.stdout.rfind("\u{1b}[?25h") > entered,
            "{signal:?}: the cursor is shown again"
        );
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_floor_that_fails_costs_no_report() {
    let rig = Rig::new("floorless");
    let executable = rig.file("ironbird");
    fs::hard_link(IRONBIRD, &executable)
        .or_else(|_| fs::copy(IRONBIRD, &executable).map(drop))
        .unwrap();
    let mut command = Command::new(&executable);
    command
        .arg("fly")
        .args(rig.own_args("fly", "--rt off --duration 2s --floor 1s"))
        .env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    // The processes of the floor's ring are started from it.
    fs::remove_file(&executable).unwrap();
    let ended = flight
        .end()
        .expect(1)
        .says("\nGates     PASS")
        .complains("cannot start a process of the ring");
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert!(rig.report()["beside"].is_null());
}

#[test]
fn limits_that_leave_no_room_for_a_flight_are_named() {
    let limited = |rig: &Rig, limit: &str| {
        let args = "--rt off --duration 1s";
        let command = rig.command_by(&["prlimit", limit], "fly", args);
        rig.launch(command).end()
    };
    let rig = Rig::new("limits");
    limited(&rig, "--stack=65536")
        .expect(1)
        .complains("the stack is limited to 64 KiB")
        .complains("ulimit -s");
    limited(&rig, "--fsize=2048")
        .expect(1)
        .complains(".json: File too large");
    rig.assert_nothing_left();
    // Enough for the directory, and not for shared memory. Whichever part is first to find that ends first.
    let ended = limited(&rig, "--fsize=8192")
        .expect(1)
        .complains(" ended before the flight began");
    let ended = ended
        .complains("may have 8 KiB in this process (ulimit -f)")
        .complains("ulimit -f unlimited");
    assert!(!ended.stderr.contains("ironbird clean"), "{ended}");
    rig.assert_nothing_left();
    let ended = limited(&rig, "--as=60000000")
        .expect(1)
        .complains("the address space is limited to 58593 KiB");
    ended.complains("ulimit -v unlimited");
    for files in [40, 56, 64] {
        let ended = limited(&rig, &format!("--nofile={files}"));
        assert!(matches!(ended.code, Some(1 | 2)), "{files} files: {ended}");
        let ended = ended.complains("ulimit -n 1024");
        assert!(
            !ended.stderr.contains("ironbird clean"),
            "{files} files: {ended}"
        );
    }
}

/// Blocks what a daemon may block, ignores what a shell may ignore, and becomes its arguments.
const DEAF: &str = "
import os, signal, sys
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
blocked = [signal.SIGALRM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD]
signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
os.execv(sys.argv[1], sys.argv[1:])
";

/// A command, started deaf to signals; none where there is no Python.
fn deaf(rig: &Rig, command: &str, args: &str) -> Option<Running> {
    has_python().then(|| rig.launch(rig.command_by(&["python3", "-c", DEAF], command, args)))
}

#[test]
fn a_flight_whose_signals_were_blocked_or_ignored_passes_and_ends() {
    let rig = Rig::new("deaf");
    let Some(fly) = deaf(&rig, "fly", "--rt off --duration 1s") else {
        return;
    };
    let result = fly.end().expect(0).result();
    assert_eq!(result["status"], "PASS", "{result:?}");
    rig.assert_nothing_left();
}

#[test]
fn a_mixer_that_was_started_deaf_ends_when_it_is_told_to() {
    let rig = Rig::new("deaf-mixer");
    let Some(mixer) = deaf(&rig, "mixer", "--rt off") else {
        return;
    };
    mixer.await_words("waiting for the plant");
    mixer.signal(Signal::TERM);
    mixer.end().expect(130);
    rig.assert_nothing_left();
}

const STAGES: [&str; 4] = ["plant", "outer", "inner", "mixer"];

/// Whether SCHED_FIFO can be had here; says so where it cannot.
fn fifo_is_granted() -> bool {
    let refusal = fifo_refusal(90);
    if let Some(refusal) = &refusal {
        not_tested(&format!("SCHED_FIFO is refused here: {refusal}"));
    }
    refusal.is_none()
}

/// Scheduling policy of a process that lives, or that nobody has waited for: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy(pid: u32) -> u32 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit_once(')')
        .unwrap()
        .1
        .split_whitespace()
        .nth(38)
        .unwrap()
        .parse()
        .unwrap()
}

/// Waits until it has ended; gives the policy that it ended under.
fn last_policy(process: &Running) -> u32 {
    wait_until("the process to end", || {
        is_gone(process.pid()).then_some(())
    });
    policy(process.pid())
}

/// A role that waits for the others, in real time.
fn waiting(rig: &Rig, role: &str) -> Running {
    let process = rig.start(role, "--rt prefer");
    process.await_words("waiting for");
    assert_eq!(policy(process.pid()), 1, "{role} has real time");
    process
}

#[test]
fn a_role_that_ends_on_one_signal_or_at_once_on_two_ends_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    // Two are there when the process goes on: it has no time to end in order.
    let twice = [Signal::STOP, Signal::INT, Signal::TERM, Signal::CONT];
    for (role, signals) in STAGES
        .iter()
        .flat_map(|it| [(it, &twice[2..3]), (it, &twice[..])])
    {
        let rig = Rig::new("signals");
        let process = waiting(&rig, role);
        signals.iter().for_each(|it| process.signal(*it));
        assert_eq!(last_policy(&process), 0, "{role}");
        process.end().expect(130);
        if signals.len() == 1 {
            rig.assert_nothing_left();
        }
        rig.run("clean", "");
    }
}

#[test]
fn roles_that_have_flown_end_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    let rig = Rig::new("flown");
    let slow = rig.slow(5);
    let args = format!("--rt prefer --config {slow} --duration 50ms");
    let roles =
        ["record", "mixer", "inner", "outer", "plant"].map(|role| (role, rig.start(role, &args)));
    for (role, process) in &roles {
        assert_eq!(last_policy(process), 0, "{role}");
    }
    for (_, process) in roles {
        process.end().expect(0);
    }
    rig.assert_nothing_left();
}
