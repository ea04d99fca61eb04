//! How flights end: signals, closed terminals, limits; and what processes hold when they end.

use crate::fault_matrix::{await_gone, demand_interrupted};
use crate::rig::{Args, IRONBIRD, Rig, Running, is_gone, lacks_tool, not_tested, send, wait_until};
use ipc::Wire;
use messages::blackboards::{RUN, Run, RunPhase};
use process::rt::fifo_refusal;
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::process::Command;

const STAGES: [&str; 4] = ["plant", "outer", "inner", "mixer"];
/// A flight that lasts until it is ended; nothing in these tests depends on its deadlines.
const LONG: &str = "--rt off --duration 600s";

#[test]
fn a_second_signal_ends_at_once_what_the_first_one_cannot() {
    let rig = Rig::new("stubborn");
    let mut flight = rig.start("fly", rig.slowly(20, "60s"));
    // The recorder's first report is there, so that there is something to print.
    rig.await_report();
    let roles = flight.roles();
    send(roles["record"], Signal::STOP);
    flight.signal(Signal::INT);
    await_gone(STAGES.map(|role| roles[role]));
    assert!(flight.is_running(), "it waits for the recorder");
    let ended = flight.interrupt().expect(130);
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    let report = rig.report();
    assert_eq!(report["verdict"]["status"], "INTERRUPTED");
    assert_eq!(report["run"]["in_flight"], false);
    assert!(is_gone(roles["record"]));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_is_over_before_the_recorder_looks_is_reported_whole() {
    let rig = Rig::new("over");
    let flight = rig.start("fly", rig.slowly(5, "50ms"));
    let roles = flight.roles();
    let wire = Wire::open(&rig.known()).unwrap();
    // From then on nobody waits for the recorder, which has armed.
    wait_until("the plant to keep to its t_0", || {
        let board = wire.blackboard_reader::<Run>(RUN).unwrap()?;
        (board.get().phase() == RunPhase::Flying).then_some(())
    });
    send(roles["record"], Signal::STOP);
    await_gone(STAGES.map(|role| roles[role]));
    drop(wire);
    send(roles["record"], Signal::CONT);
    flight.end().expect(0);
    let report = rig.final_report();
    for role in STAGES {
        let role = &report.roles[role];
        assert!(role.landed && role.ticks_run > 0, "{role:?}");
    }
    assert!(report.ticks.identity_holds, "{:?}", report.ticks);
    rig.assert_nothing_left();
}

/// Kills a flight with all its processes, none of which can clean up.
pub(crate) fn kill_all(flight: Running) {
    let roles = flight.roles();
    // A stopped process does not act on the end of its supervisor.
    roles.values().for_each(|pid| send(*pid, Signal::STOP));
    flight.signal(Signal::KILL);
    flight.end();
    roles.values().for_each(|pid| send(*pid, Signal::KILL));
    await_gone(roles.into_values());
}

#[test]
fn each_role_may_receive_a_signal_several_times() {
    let rig = Rig::new("thrice");
    let flight = rig.take_off(LONG);
    for pid in flight.roles().into_values() {
        let pid = Pid::from_raw(pid.cast_signed()).unwrap();
        // One of the roles before may have ended it by now.
        for _ in 0..3 {
            let _ = kill_process(pid, Signal::TERM);
        }
    }
    flight.end().expect(130);
    demand_interrupted(&rig, "three signals for each role");
    rig.assert_nothing_left();
}

#[test]
fn nohup_is_respected() {
    let rig = Rig::new("nohup");
    let nohup = ["env", "--ignore-signal=HUP"];
    let flight = rig.launch(rig.command_by(&nohup, "fly", "--rt off --duration 2s"));
    rig.await_flight();
    flight.signal(Signal::HUP);
    // There are no standbys where nothing is restarted.
    rig.await_tick(1500);
    assert_eq!(rig.processes_of("inner").len(), 1);
    assert_eq!(flight.end().expect(0).result()["status"], "PASS");
    assert_eq!(rig.report()["run"]["ending"], "completed");
}

/// A command in a terminal of its own, which SIGUSR1 closes; none where there is no python3.
fn in_a_terminal(rig: &Rig, prefix: &[&str], command: &str, args: impl Args) -> Option<Running> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig/closed_terminal.py");
    let program = [&["python3", script], prefix].concat();
    has_python().then(|| rig.launch(rig.command_by(&program, command, args)))
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
#[ignore = "long: part of the gate"]
fn a_closed_terminal_ends_a_flight_with_a_dashboard_in_order() {
    let rig = Rig::new("hangup");
    let Some(terminal) = in_a_terminal(&rig, &[], "fly", format!("{LONG} --watch")) else {
        return;
    };
    rig.await_flight();
    terminal.await_output("position error, last");
    let commands = STAGES.iter().chain(&["record", "fly", "watch"]);
    let processes: Vec<u32> = commands.flat_map(|it| rig.processes_of(it)).collect();
    assert_eq!(processes.len(), 7, "{processes:?}");
    terminal.signal(Signal::USR1);
    terminal.end().says("\nended 130 ");
    await_gone(processes);
    demand_interrupted(&rig, "terminal closed");
    rig.assert_nothing_left();
}

#[test]
fn a_dashboard_ends_when_its_terminal_is_closed_also_where_sighup_is_ignored() {
    for ignored in ["--ignore-signal=HUP", "--default-signal=HUP"] {
        let rig = Rig::new("gone");
        let Some(terminal) = in_a_terminal(&rig, &["env", ignored], "watch", "") else {
            return;
        };
        terminal.await_output("\u{1b}[?1049h");
        let watchers = rig.processes_of("watch");
        assert_eq!(watchers.len(), 1);
        terminal.signal(Signal::USR1);
        terminal.end().says("\nended 130 ");
        await_gone(watchers);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_dashboard_leaves_a_sane_terminal() {
    for signal in [Signal::KILL, Signal::HUP, Signal::QUIT] {
        let rig = Rig::new("sane");
        let config = rig.airborne("trajectory = \"hover\"\n");
        let flags = format!("--rt off --duration 6s --watch --config {config}");
        let Some(terminal) = in_a_terminal(&rig, &[], "fly", flags) else {
            return;
        };
        terminal.await_output("position error, last");
        send(rig.processes_of("watch")[0], signal);
        // The supervisor has its terminal back, with its own line.
        terminal.await_output(" of 6.0 s   missed");
        let output = terminal.end().says("\nended 0 icanon True\n").stdout;
        // The alternate screen is left, and the cursor is visible again.
        let entered = output.rfind("\u{1b}[?1049h");
        assert!(entered.is_some() && output.rfind("\u{1b}[?1049l") > entered);
        assert!(output.rfind("\u{1b}[?25h") > entered, "{signal:?}");
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_baseline_measurement_that_fails_costs_no_report() {
    let rig = Rig::new("floorless");
    let executable = rig.file("ironbird");
    fs::hard_link(IRONBIRD, &executable)
        .or_else(|_| fs::copy(IRONBIRD, &executable).map(drop))
        .unwrap();
    let args = rig.own_args("fly", "--rt off --duration 2s --floor 1s");
    let mut command = Command::new(&executable);
    command
        .arg("fly")
        .args(args)
        .env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    // The processes of the ring are started from it.
    fs::remove_file(&executable).unwrap();
    let ended = flight.end().expect(1).says("\nGates     PASS");
    let ended = ended.complains("cannot start a process of the ring");
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert!(rig.report()["beside"].is_null());
}

#[test]
fn limits_that_leave_no_room_for_a_flight_are_named() {
    let rig = Rig::new("limits");
    let files = "ulimit -n 1024";
    for (limit, words) in [
        (
            "--stack=65536",
            ["the stack is limited to 64 KiB", "ulimit -s"],
        ),
        ("--fsize=2048", [".json: File too large", ""]),
        // Enough for the directory, and not for shared memory. Whichever process is first to find that ends first.
        (
            "--fsize=8192",
            [" ended before the flight began", "ulimit -f unlimited"],
        ),
        (
            "--fsize=8192",
            ["may have 8 KiB in this process (ulimit -f)", ""],
        ),
        (
            "--as=60000000",
            [
                "the address space is limited to 58593 KiB",
                "ulimit -v unlimited",
            ],
        ),
        ("--nofile=40", [files, ""]),
        ("--nofile=56", [files, ""]),
        ("--nofile=64", [files, ""]),
    ] {
        let args = "--rt off --duration 1s";
        let ended = rig.launch(rig.command_by(&["prlimit", limit], "fly", args));
        let ended = ended.end().complains(words[0]).complains(words[1]);
        let is_refused = ended.code == Some(1) || ended.code == Some(2) && words[0] == files;
        assert!(
            is_refused && !ended.stderr.contains("ironbird clean"),
            "{ended}"
        );
        rig.assert_nothing_left();
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

#[test]
fn processes_whose_signals_were_blocked_or_ignored_fly_and_end() {
    if !has_python() {
        return;
    }
    let rig = Rig::new("deaf");
    let deaf = |command: &str, args: &str| {
        rig.launch(rig.command_by(&["python3", "-c", DEAF], command, args))
    };
    let flown = deaf("fly", "--rt off --duration 1s").end().expect(0);
    assert_eq!(flown.result()["status"], "PASS", "{flown}");
    let mixer = deaf("mixer", "--rt off");
    mixer.await_words("waiting for the plant");
    mixer.signal(Signal::TERM);
    mixer.end().expect(130);
    rig.assert_nothing_left();
}

/// Whether SCHED_FIFO is granted here; says so where it is not.
fn fifo_is_granted() -> bool {
    let refusal = fifo_refusal(90);
    if let Some(refusal) = &refusal {
        not_tested(&format!("SCHED_FIFO is refused here: {refusal}"));
    }
    refusal.is_none()
}

/// Scheduling policy of a process that lives, or that nobody has waited for: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy(process: &Running) -> u32 {
    let stat = fs::read_to_string(format!("/proc/{}/stat", process.pid())).unwrap();
    let (_, fields) = stat.rsplit_once(')').unwrap();
    fields.split_whitespace().nth(38).unwrap().parse().unwrap()
}

/// Demands that it ends without real time.
fn ends_without_real_time(process: Running, code: i32) {
    await_gone([process.pid()]);
    assert_eq!(policy(&process), 0);
    process.end().expect(code);
}

#[test]
fn a_role_ends_without_real_time_on_one_signal_on_two_and_after_a_flight() {
    if !fifo_is_granted() {
        return;
    }
    // Two are there when the process continues: it has no time to end in order.
    let twice = [Signal::STOP, Signal::INT, Signal::TERM, Signal::CONT];
    for role in STAGES {
        for signals in [&twice[2..3], &twice] {
            let rig = Rig::new("signals");
            let process = rig.start(role, "--rt prefer");
            process.await_words("waiting for");
            assert_eq!(policy(&process), 1, "{role} has real time");
            signals.iter().for_each(|it| process.signal(*it));
            ends_without_real_time(process, 130);
            if signals.len() == 1 {
                rig.assert_nothing_left();
            }
            rig.run("clean", "");
        }
    }
    let rig = Rig::new("flown");
    let args = format!("--rt prefer --config {} --duration 50ms", rig.slow(5));
    let roles = ["record", "mixer", "inner", "outer", "plant"].map(|role| rig.start(role, &args));
    for process in roles {
        ends_without_real_time(process, 0);
    }
    rig.assert_nothing_left();
}
