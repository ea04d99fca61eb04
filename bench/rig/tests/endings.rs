//! How flights end: signals, dead launchers, dead roles, leftovers.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::rig::{Ended, Rig, Running, is_gone, process_of, send, wait_until};
use model::boards::{RUN, Run, RunPhase};
use rustix::process::Signal;
use wire::Wire;

/// A long flight in slow motion, in the air; nothing in these tests depends on its deadlines.
fn in_the_air(rig: &Rig) -> Running {
    rig.take_off(&["--rt", "off", "--config", &rig.slow(20), "--duration", "60s"])
}

fn await_gone(pids: impl IntoIterator<Item = u32>) {
    for pid in pids {
        wait_until(&format!("process {pid} to end"), || is_gone(pid).then_some(()));
    }
}

/// A flight that was interrupted in order: report printed, result line last, files final, nothing left.
fn assert_interrupted(rig: &Rig, ended: Ended) {
    let ended = ended.expect(130).says("\nFlown     interrupted: ").says("\nGates     INTERRUPTED\n");
    assert_eq!(ended.result()["status"], "INTERRUPTED");
    let report = rig.report();
    assert_eq!((&report["run"]["ending"], &report["run"]["in_flight"]), (&"interrupted".into(), &false.into()));
    let roles = report["roles"].as_object().unwrap();
    let landed = roles.iter().filter(|(name, role)| *name != "record" && role["landed"] == true).count();
    assert_eq!(landed, 4, "each loop said its last word: {roles:?}");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn an_interrupted_launcher_ends_the_flight_in_order() {
    for signal in [Signal::INT, Signal::TERM] {
        let rig = Rig::new("interrupted");
        let flight = in_the_air(&rig);
        flight.signal(signal);
        assert_interrupted(&rig, flight.end());
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn an_interrupted_role_ends_the_flight_of_all_in_order() {
    for role in ["plant", "outer", "inner", "mixer", "record"] {
        let rig = Rig::new("one-role");
        let flight = in_the_air(&rig);
        send(flight.roles()[role], Signal::TERM);
        assert_interrupted(&rig, flight.end());
    }
}

#[test]
fn a_second_signal_ends_at_once_what_the_first_one_cannot() {
    let rig = Rig::new("stubborn");
    let mut flight = in_the_air(&rig);
    // The recorder's first report is there, so that there is something to print.
    wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
    let roles = flight.roles();
    send(roles["record"], Signal::STOP);
    flight.signal(Signal::INT);
    await_gone(["plant", "outer", "inner", "mixer"].map(|role| roles[role]));
    assert!(flight.is_running(), "it waits for the recorder, which is stopped");
    let second = Instant::now();
    flight.signal(Signal::INT);
    let ended = flight.end().expect(130);
    assert!(second.elapsed() < Duration::from_secs(4), "the launcher's own patience is 5 s: {:?}", second.elapsed());
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    let report = rig.report();
    assert_eq!((&report["verdict"]["status"], &report["run"]["in_flight"]), (&"INTERRUPTED".into(), &false.into()));
    assert!(is_gone(roles["record"]));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn roles_end_with_a_killed_launcher_and_the_next_flight_is_free() {
    let rig = Rig::new("orphans");
    let flight = in_the_air(&rig);
    let roles = flight.roles();
    flight.signal(Signal::KILL);
    assert_eq!(flight.end().code, None, "a signal ended it");
    await_gone(roles.into_values());
    let next = rig.run("fly", &["--rt", "off", "--config", &rig.slow(5), "--duration", "100ms"]).expect(0);
    assert_eq!(next.result()["status"], "PASS");
    rig.assert_nothing_left();

    let flight = in_the_air(&rig);
    let roles = flight.roles();
    flight.signal(Signal::KILL);
    flight.end();
    await_gone(roles.into_values());
    let directory = rig.root().join(&rig.instance);
    assert!(!directory.exists(), "the last role to leave tidies up for a launcher that cannot");
    rig.assert_nothing_left();
    rig.run("clean", &[]).expect(0).says("nothing to remove");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_is_over_before_the_recorder_looks_is_reported_whole() {
    let rig = Rig::new("over");
    let flight = rig.start("fly", &["--rt", "off", "--config", &rig.slow(5), "--duration", "50ms"]);
    let roles = flight.roles();
    let wire = Wire::open(&rig.known()).unwrap();
    // From then on nobody waits for the recorder, which has armed.
    wait_until("the plant to keep to its t_0", || {
        let board = wire.board_reader::<Run>(RUN).unwrap()?;
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
        assert!(said["landed"] == true && said["ticks_run"].as_u64().unwrap() > 0, "{role}: {report}");
    }
    assert_eq!(report["ticks"]["identity_holds"], true, "{report}");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_role_aborts_the_flight_and_is_named() {
    for role in ["plant", "inner", "record"] {
        let rig = Rig::new("killed");
        let flight = in_the_air(&rig);
        wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
        send(flight.roles()[role], Signal::KILL);
        let process = process_of(role);
        let ended = flight.end().expect(1).complains(&format!("{process}: signal: 9 (SIGKILL)"));
        assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
        let ended = ended.says(&format!("the {process} died: signal: 9 (SIGKILL)"));
        let gates = rig.run("report", &["--section", "gates"]).expect(0);
        gates.says("  ok   flight envelope: not left until the end of the record (limit ");
        assert!(!ended.stdout.contains("IN FLIGHT"), "{ended}");
        let report = rig.report();
        assert_eq!((&report["verdict"]["status"], &report["verdict"]["exit_code"]), (&"ABORTED".into(), &1.into()));
        rig.assert_nothing_left();
    }
}

#[test]
fn a_role_killed_before_the_flight_is_named_too() {
    let rig = Rig::new("still-born");
    let flight = rig.start("fly", &["--rt", "off", "--config", &rig.slow(1000)]);
    // Stopped, so that nobody takes off without it.
    let outer = flight.roles()["outer"];
    send(outer, Signal::STOP);
    sleep(Duration::from_millis(100));
    send(outer, Signal::KILL);
    // It may have armed before it was stopped; then it died in the air.
    flight.end().expect(1).complains("outer process");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_process_that_hangs_after_the_flight_is_named_and_killed() {
    let hangs = |role: &str| {
        let rig = Rig::new("hangs");
        let flight = rig.take_off(&["--rt", "off", "--duration", "3s"]);
        wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
        send(flight.roles()[role], Signal::STOP);
        let ended = flight.end().expect(1);
        assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
        ended.tells(&format!("the {} did not end within 30 s of the flight and was killed", process_of(role)));
        rig.assert_nothing_left();
    };
    // Side by side: each takes as long as the launcher's patience.
    std::thread::scope(|scope| ["mixer", "plant", "record"].map(|role| scope.spawn(move || hangs(role))).map(drop));
}

/// Kills a flight with all its processes, none of which can say a last word.
fn kill_all(flight: Running) {
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
    let bystander = other.start("plant", &["--rt", "off"]);
    bystander.await_words("waiting for");
    let directory = rig.root().join(&rig.instance);
    let allow = |mode: u32| fs::set_permissions(&directory, fs::Permissions::from_mode(mode)).unwrap();
    allow(0o770);
    let kept = format!("kept the shared memory of instance `{}`: {} is not used", rig.instance, directory.display());
    rig.run("clean", &[]).expect(0).says(&kept);
    allow(0o700);
    let mut clean = rig.run("clean", &[]).expect(0);
    for segment in left {
        clean = clean.says(&format!("removed /dev/shm/{segment}\n"));
    }
    clean.says(&format!("removed {}\n", directory.display()));
    rig.assert_nothing_left();
    assert!(!other.segments().is_empty(), "another instance keeps its own");
    bystander.signal(Signal::TERM);
    bystander.end().expect(130);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_after_killed_processes_needs_no_cleaning() {
    let rig = Rig::new("phoenix");
    kill_all(in_the_air(&rig));
    assert!(!rig.segments().is_empty());
    let next = rig.run("fly", &["--rt", "off", "--config", &rig.slow(5), "--duration", "100ms"]).expect(0);
    assert_eq!(next.result()["status"], "PASS");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn cleaning_beside_a_flight_leaves_it_alone() {
    let rig = Rig::new("cleaned");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(20), "--duration", "100ms"]);
    rig.run("clean", &[]).expect(0).says(&format!("instance `{}` is alive", rig.instance));
    let result = flight.end().expect(0).result();
    assert_eq!(result["status"], "PASS");
    rig.assert_nothing_left();
}
