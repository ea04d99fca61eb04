//! What becomes of a flight whose launcher or role is told to end, or dies.
//!
//! Terminals are made by python3; where there is none, those tests are left out, and say so.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use crate::deaths::in_the_air;
use crate::rig::{
    IRONBIRD, Rig, Running, copy_executable, is_gone, lacks_tool, not_tested, process_of, rounds, send, wait_until,
};
use rustix::process::Signal;

const ROLES: [&str; 5] = ["plant", "outer", "inner", "mixer", "record"];
/// A flight that lasts until it is ended; nothing in these tests depends on its deadlines.
const LONG: [&str; 4] = ["--rt", "off", "--duration", "600s"];

fn await_gone(pids: impl IntoIterator<Item = u32>) {
    for pid in pids {
        wait_until(&format!("process {pid} to end"), || is_gone(pid).then_some(()));
    }
}

/// The flight ended in order: a final report in all its forms, a whole log, nothing left.
fn assert_interrupted_whole(rig: &Rig, what: &str) {
    let report = rig.report();
    assert_eq!(report["verdict"]["status"], "INTERRUPTED", "{what}: {}", report["verdict"]);
    assert_eq!(report["run"]["in_flight"], false, "{what}");
    for file in ["report.html", "report.txt", "flight.svg"] {
        assert!(rig.out().join("latest").join(file).exists(), "{what}: no {file}");
    }
    let replayed = rig.run("replay", &["--verify"]).expect(0);
    assert!(!replayed.stderr.contains("truncated"), "{what}: {replayed}");
    rig.assert_nothing_left();
}

/// A flight in a terminal of its own, as `command` runs it there; none where there is no python3.
fn in_a_terminal(rig: &Rig, command: &[&str]) -> Option<Running> {
    if !Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success()) {
        lacks_tool("no terminal is closed: there is no python3");
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig/closed_terminal.py");
    let mut terminal = Command::new("python3");
    terminal.arg(script).args(command).env("IRONBIRD_ROOT", rig.root());
    Some(rig.launch(terminal))
}

/// `ironbird fly` with the rig's own arguments.
fn fly(rig: &Rig, args: &[&str]) -> Vec<String> {
    [IRONBIRD, "fly"].map(str::to_owned).into_iter().chain(rig.own_args("fly", args)).collect()
}

#[test]
#[ignore = "long: part of the gate"]
fn every_signal_that_asks_for_the_end_gets_it_in_order_however_often_it_comes() {
    for signal in [Signal::HUP, Signal::QUIT, Signal::TERM] {
        let rig = Rig::new("asked");
        let flight = rig.take_off(&LONG);
        let times = if signal == Signal::QUIT { 1 } else { 3 };
        for _ in 0..times {
            flight.signal(signal);
            sleep(Duration::from_millis(120));
        }
        let ended = flight.end().expect(130);
        assert_eq!(ended.result()["status"], "INTERRUPTED", "{signal:?}: {ended}");
        assert_interrupted_whole(&rig, &format!("{signal:?}"));
    }
}

#[test]
fn a_role_takes_its_launchers_death_for_one_however_often_it_is_told() {
    let rig = Rig::new("told");
    let flight = rig.take_off(&LONG);
    for pid in flight.roles().into_values() {
        for _ in 0..3 {
            send(pid, Signal::TERM);
        }
    }
    flight.end().expect(130);
    assert_interrupted_whole(&rig, "each role was told three times");
}

#[test]
fn nohup_is_respected() {
    let rig = Rig::new("nohup");
    let mut command = Command::new("env");
    command.arg("--ignore-signal=HUP").args(fly(&rig, &["--rt", "off", "--duration", "2s"]));
    command.env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    flight.signal(Signal::HUP);
    let result = flight.end().expect(0).result();
    assert_eq!((result["status"].as_str(), result["ticks"].is_empty()), ("PASS", false));
    assert_eq!(rig.report()["run"]["ending"], "completed");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_may_not_hear_of_its_childrens_ends_hears_of_them() {
    let rig = Rig::new("deaf");
    let mut command = Command::new("env");
    command.arg("--ignore-signal=CHLD").args(fly(&rig, &["--rt", "off", "--duration", "1s"]));
    command.env("IRONBIRD_ROOT", rig.root());
    assert_eq!(rig.launch(command).end().expect(0).result()["status"], "PASS");
    rig.assert_nothing_left();
}

/// Kills the launcher at instants of a flight that differ from round to round.
fn kill_launchers(rounds: u64) {
    for round in 0..rounds {
        let rig = Rig::new("beheaded");
        let flight = rig.take_off(&LONG);
        let roles = flight.roles();
        // No two rounds alike, and each the same in every run of the test.
        let after = Duration::from_millis(round * 7919 % 2500);
        sleep(after);
        flight.signal(Signal::KILL);
        flight.end();
        await_gone(roles.into_values());
        assert_interrupted_whole(&rig, &format!("round {round}, killed after {after:?}"));
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_launchers_flight_ends_once_and_in_order() {
    kill_launchers(3);
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn a_killed_launchers_flight_ends_once_and_in_order_at_any_instant() {
    kill_launchers(rounds());
}

#[test]
#[ignore = "long: part of the gate"]
fn a_closed_terminal_ends_the_flight_in_order() {
    for (shell, watch) in [(false, false), (true, false), (false, true)] {
        let rig = Rig::new("hangup");
        let mut args = LONG.to_vec();
        args.extend(watch.then_some("--watch"));
        let flight = fly(&rig, &args);
        let line = format!("{}; true", flight.join(" "));
        let mut command: Vec<&str> = if shell { vec!["sh", "-c", &line] } else { vec![] };
        command.extend(flight.iter().filter(|_| !shell).map(String::as_str));
        let Some(terminal) = in_a_terminal(&rig, &command) else { return };
        rig.await_flight();
        if watch {
            terminal.await_output("position error, last");
        }
        let processes: Vec<u32> =
            ROLES.iter().chain(&["fly", "watch"]).flat_map(|command| rig.processes_of(command)).collect();
        assert_eq!(processes.len(), if watch { 7 } else { 6 }, "{processes:?}");
        terminal.signal(Signal::USR1);
        let ended = terminal.end();
        if !shell {
            assert!(ended.stdout.contains("\nended 130 "), "{ended}");
        }
        await_gone(processes);
        assert_interrupted_whole(&rig, &format!("shell {shell}, watch {watch}"));
    }
}

#[test]
fn a_dashboard_whose_terminal_is_closed_ends_though_it_hears_of_no_hangup() {
    for ignored in ["--ignore-signal=HUP", "--default-signal=HUP"] {
        let rig = Rig::new("gone");
        let command = ["env", ignored, IRONBIRD, "watch", "--instance", &rig.instance];
        let Some(terminal) = in_a_terminal(&rig, &command) else { return };
        terminal.await_output("\u{1b}[?1049h");
        let [watcher] = rig.processes_of("watch")[..] else { panic!("one dashboard") };
        terminal.signal(Signal::USR1);
        let ended = terminal.end();
        assert!(ended.stdout.contains("\nended 130 "), "{ignored}: {ended}");
        await_gone(vec![watcher]);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_dashboard_leaves_a_sane_terminal() {
    for told in [Signal::KILL, Signal::HUP, Signal::QUIT] {
        let rig = Rig::new("sane");
        // A busy machine may let it fall: not to a ground.
        let config = in_the_air(&rig, 1);
        let flight = ["--rt", "off", "--duration", "6s", "--trajectory", "hover", "--watch", "--config", &config];
        let command = fly(&rig, &flight);
        let Some(terminal) = in_a_terminal(&rig, &command.iter().map(String::as_str).collect::<Vec<_>>()) else {
            return;
        };
        terminal.await_output("position error, last");
        let [watcher] = rig.processes_of("watch")[..] else { panic!("one dashboard") };
        send(watcher, told);
        // The launcher has its terminal back, with its own line.
        terminal.await_output(" of 6.0 s   missed");
        let ended = terminal.end();
        assert!(ended.stdout.contains("\nended 0 icanon True\n"), "{told:?}: {ended}");
        let (left, entered) = (ended.stdout.rfind("\u{1b}[?1049l"), ended.stdout.rfind("\u{1b}[?1049h"));
        assert!(entered.is_some() && left > entered, "{told:?}: the alternate screen is left: {ended}");
        assert!(ended.stdout.rfind("\u{1b}[?25h") > entered, "{told:?}: the cursor is shown again");
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_role_that_is_ended_while_all_start_ends_the_wait_and_is_named() {
    let first = Rig::new("newest");
    first.run("fly", &["--rt", "off", "--duration", "100ms"]);
    for (i, role) in ROLES.into_iter().enumerate() {
        for (j, signal) in [Signal::INT, Signal::TERM, Signal::KILL].into_iter().enumerate() {
            let rig = Rig::new("still-born");
            let flight = rig.start("fly", &LONG);
            let pid = flight.roles()[role];
            let after = Duration::from_millis(((3 * i + j) * 20) as u64);
            sleep(after);
            send(pid, signal);
            let what = format!("{role} was sent {signal:?} after {after:?}");
            let ended = flight.end();
            let code = if signal == Signal::KILL { 1 } else { 130 };
            assert_eq!(ended.code, Some(code), "{what}: {ended}");
            // It may have been in the air by then.
            if !ended.stdout.contains("RESULT ") {
                let ended = ended.complains(&format!("{}: ", process_of(role))).complains("before the flight ");
                // Only a recorder that had logged something leaves a directory.
                let recorded = code == 1 && ended.stderr.contains("has what was recorded");
                assert_eq!(rig.run_directories().is_empty(), !recorded, "{what}: {ended}");
                assert!(rig.out().join("latest").read_link().is_err(), "{what}");
            }
            rig.assert_nothing_left();
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_signal_while_all_start_is_an_interruption() {
    for (i, after_ms) in (0..300).step_by(25).enumerate() {
        let rig = Rig::new("early");
        let flight = rig.start("fly", &LONG);
        // From then on it handles signals.
        wait_until("the flight's directory", || (!rig.run_directories().is_empty()).then_some(()));
        sleep(Duration::from_millis(after_ms));
        let signal = [Signal::TERM, Signal::INT, Signal::HUP][i % 3];
        flight.signal(signal);
        let ended = flight.end();
        assert_eq!(ended.code, Some(130), "{signal:?} after {after_ms} ms: {ended}");
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_waits_for_a_process_says_where_to_look() {
    // Stopped, so that nobody takes off without it; where it stands is up to the instant, and the plant may need it.
    let unready = |_| {
        let rig = Rig::new("unready");
        let flight = rig.start("fly", &LONG);
        let outer = flight.roles()["outer"];
        send(outer, Signal::STOP);
        sleep(Duration::from_secs(1));
        let log = fs::read_to_string(rig.out().join(&rig.run_directories()[0]).join("plant.log")).unwrap();
        let last = log.lines().last().unwrap_or_default().to_owned();
        if last.contains("waiting for outer") {
            return Some((rig, flight, outer));
        }
        flight.signal(Signal::INT);
        send(outer, Signal::CONT);
        flight.end();
        None
    };
    let (rig, flight, outer) = (0..20).find_map(unready).unwrap();
    flight.await_words("still waiting for all processes to be ready; plant.log says for which");
    flight.signal(Signal::INT);
    send(outer, Signal::CONT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn roles_started_by_hand_say_how_the_flight_ended() {
    let rig = Rig::new("by-hand");
    for (duration, signal, words) in
        [("200ms", None, "completed after 0.2 s"), ("600s", Some(Signal::HUP), "interrupted")]
    {
        let roles = ROLES.map(|role| (role, rig.start(role, &["--rt", "off", "--duration", duration])));
        wait_until("the flight", || (rig.run_directories().len() == 1).then_some(()));
        if let Some(signal) = signal {
            rig.await_flight();
            sleep(Duration::from_millis(200));
            roles[1].1.signal(signal);
        }
        for (role, process) in roles {
            let ended = process.end();
            if role != "record" {
                ended.expect(0).complains(&format!("{role}: flight {words}"));
            }
        }
        rig.assert_nothing_left();
        fs::remove_dir_all(rig.out()).unwrap();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_floor_that_fails_costs_no_report() {
    let rig = Rig::new("floorless");
    let executable = rig.path("ironbird");
    fs::hard_link(IRONBIRD, &executable).or_else(|_| fs::copy(IRONBIRD, &executable).map(drop)).unwrap();
    let mut command = Command::new(&executable);
    command
        .arg("fly")
        .args(rig.own_args("fly", &["--rt", "off", "--duration", "2s", "--floor", "1s"]))
        .env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(command);
    rig.await_flight();
    // The processes of the floor's ring are started from it.
    fs::remove_file(&executable).unwrap();
    let ended = flight.end().expect(1).says("\nGates     PASS").complains("cannot start a process of the ring");
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert!(rig.report()["beside"].is_null());
}

/// What the kernel lets the flight of another user have.
fn unprivileged(rig: &Rig, limit: &str) -> Option<Command> {
    let is_root = rustix::process::geteuid().is_root();
    let may = Command::new("setpriv").args(["--reuid", "65534", "true"]).status().is_ok_and(|it| it.success());
    if !is_root || !may {
        not_tested("no limit on processes: this needs root and setpriv");
        return None;
    }
    let copy: PathBuf = rig.path("ironbird");
    copy_executable(&copy);
    for directory in [rig.path("."), rig.root(), rig.out()] {
        fs::create_dir_all(&directory).unwrap();
        std::os::unix::fs::chown(&directory, Some(65534), Some(65534)).unwrap();
    }
    let mut command = Command::new("setpriv");
    command.args(["--reuid", "65534", "--regid", "65534", "--clear-groups", "prlimit", limit]).arg(copy);
    command.arg("fly").args(rig.own_args("fly", &["--rt", "off", "--duration", "1s"])).env("IRONBIRD_ROOT", rig.root());
    Some(command)
}

#[test]
fn limits_that_leave_no_room_for_a_flight_are_named() {
    let limited = |rig: &Rig, limit: &str| {
        let mut command = Command::new("prlimit");
        command.arg(limit).args(fly(rig, &["--rt", "off", "--duration", "1s"])).env("IRONBIRD_ROOT", rig.root());
        rig.launch(command).end()
    };
    let rig = Rig::new("limits");
    limited(&rig, "--stack=65536").expect(1).complains("the stack may have 64 KiB").complains("ulimit -s");
    limited(&rig, "--fsize=2048").expect(1).complains(".json: File too large");
    rig.assert_nothing_left();
    // Enough for the directory, and not for shared memory. Whichever part is first to find that ends first.
    let ended = limited(&rig, "--fsize=8192").expect(1).complains(" ended before the flight began");
    let ended = ended.complains("may have 8 KiB in this process (ulimit -f)").complains("ulimit -f unlimited");
    assert!(!ended.stderr.contains("ironbird clean"), "{ended}");
    rig.assert_nothing_left();
    let ended = limited(&rig, "--as=60000000").expect(1).complains("the address space may have 58593 KiB");
    ended.complains("ulimit -v unlimited");
    let rig = Rig::new("nproc");
    let Some(command) = unprivileged(&rig, "--nproc=1") else { return };
    let ended = rig.launch(command).end().expect(1);
    let ended = ended.complains("cannot start the plant process: Resource temporarily unavailable");
    ended.complains("ulimit -u");
}
