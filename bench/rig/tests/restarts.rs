//! Processes that die and are started again: by the supervisor, by somebody else, after everybody was killed.

use crate::rig::{self, Rig, Running, in_own_mounts, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use ipc::Wire;
use ipc::clock::{now_ns, sleep_until};
use messages::blackboards::{RolePhase, Run, Status};
use messages::grid::Pace;
use messages::role::Role;
use process::session::status_board;
use report::schema::Report;
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::fs;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

/// What every flight here is flown with.
pub(crate) const RESTART: [&str; 4] = ["--on-death", "restart", "--trajectory", "hover"];

/// Settings of slow motion without a ground: whoever hovers at its height falls through it while a stage is missing.
pub(crate) fn in_the_air(rig: &Rig, slowdown: u64) -> String {
    rig.airborne(&format!("slowdown = {slowdown}\n"))
}

/// A flight in the air, and what its plant says of it.
pub(crate) fn take_off(rig: &Rig, slowdown: u64, args: &[&str]) -> (Running, Run) {
    let config = in_the_air(rig, slowdown);
    let flight = rig.start("fly", [&RESTART[..], &["--config", &config], args].concat());
    (flight, rig.await_tick(0))
}

/// Sends a signal to a role at a tick; its process.
pub(crate) fn strike(rig: &Rig, run: &Run, tick: u64, role: Role, signal: Signal) -> u32 {
    let Pace::Realtime(grid) = run.pace() else {
        panic!("a flight in lockstep has no clock")
    };
    while now_ns() < grid.begin_of(tick) {
        sleep_until(grid.begin_of(tick));
    }
    let pid = rig.known().pid_of(role).unwrap();
    let process = Pid::from_raw(i32::try_from(pid).unwrap()).unwrap();
    kill_process(process, signal).unwrap();
    pid
}

/// Waits until another process than this one flies in a role.
pub(crate) fn await_successor(rig: &Rig, role: Role, dead: u32) -> u32 {
    let wire = Wire::open(&rig.known()).unwrap();
    let pid = wait_until(&format!("another {role} process to fly"), || {
        let status = wire
            .blackboard_reader::<Status>(&status_board(role))
            .unwrap()?
            .get();
        (status.phase() == RolePhase::Flying
            && status.pid != u64::from(dead)
            && status.ticks_run > 0)
            .then_some(status.pid)
    });
    u32::try_from(pid).unwrap()
}

pub(crate) fn report(rig: &Rig) -> Report {
    Report::read(&rig.out().join("latest/report.json")).unwrap()
}

/// The replay has every bit of the record.
pub(crate) fn assert_replayed(rig: &Rig) {
    rig.ok("replay --verify").says("identical");
}

/// The estimates of all wrenches of a flight's log, with the epoch of each.
fn estimates(rig: &Rig) -> Vec<(u64, [f64; 3])> {
    let (entries, _) = rig::read_log(&rig.out().join("latest/flight.mcap"));
    let wrench = |entry: &LogEntry| match entry {
        LogEntry::Wrench(message) => {
            Some((message.envelope.epoch, estimate(&message.content.telemetry)))
        }
        _ => None,
    };
    entries.iter().filter_map(wrench).collect()
}

#[test]
#[ignore = "long: part of the gate"]
fn an_inner_loop_begins_at_its_priors_or_where_its_predecessor_was() {
    for resumes in [false, true] {
        let rig = Rig::new("resumes");
        let resume = if resumes { "--resume-estimates" } else { "" };
        let flight = rig.start(
            "fly",
            format!("--on-death restart --rt off --duration 4s --trajectory lissajous {resume}"),
        );
        let run = rig.await_tick(0);
        strike(&rig, &run, 2500, Role::Inner, Signal::KILL);
        flight.end().expect(0);
        let estimates = estimates(&rig);
        let begin = estimates
            .windows(2)
            .position(|pair| pair[0].0 != pair[1].0)
            .unwrap()
            + 1;
        let (before, first) = (&estimates[begin - 2..begin], estimates[begin].1);
        let (prior, is_taken_over) = (
            estimates[0].1,
            before.iter().any(|(_, last)| *last == first),
        );
        assert_eq!(
            (is_taken_over, first == prior),
            (resumes, !resumes),
            "{before:?} -> {first:?}"
        );
        let said = fs::read_to_string(rig.out().join("latest/inner.log")).unwrap();
        assert_eq!(
            said.contains("begins with the last estimates"),
            resumes,
            "{said}"
        );
        assert_replayed(&rig);
    }
}

/// The five roles as systemd would have them: each is started again 100 ms after it has failed.
#[test]
#[ignore = "long: part of the gate"]
fn roles_that_somebody_else_starts_again_are_reported_and_replayed_alike() {
    let rig = Rig::new("unit");
    let config = in_the_air(&rig, 2);
    let options = format!("--rt off --config {config} --trajectory hover --duration 2s");
    // What examples/systemd/ironbird@.service says: Restart=on-failure, RestartSec=100ms, SuccessExitStatus=130 3.
    let kept = |role: &str| {
        let command = rig.command(role, &options);
        let mut keeper = Command::new("sh");
        let forever = "until \"$@\" || case $? in 3|130) ;; *) false ;; esac; do sleep 0.1; done";
        keeper.args(["-c", forever, "sh"]);
        keeper
            .arg(command.get_program())
            .args(command.get_args())
            .env("IRONBIRD_ROOT", rig.root());
        rig.launch(keeper)
    };
    let keepers = ["outer", "inner", "mixer", "record", "plant"].map(kept);
    let run = rig.await_tick(0);
    for (role, tick) in [(Role::Inner, 400), (Role::Outer, 800), (Role::Mixer, 1200)] {
        let dead = strike(&rig, &run, tick, role, Signal::KILL);
        await_successor(&rig, role, dead);
    }
    keepers
        .into_iter()
        .for_each(|keeper| drop(keeper.end().expect(0)));
    let report = report(&rig);
    let roles: Vec<&str> = report
        .deaths
        .iter()
        .map(|death| death.role.as_str())
        .collect();
    assert_eq!(roles, ["inner", "outer", "mixer"], "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(
            death.how.is_empty() && death.noticed_after_ms.is_none(),
            "nobody told: {death:?}"
        );
        // So long its keeper sleeps alone.
        assert!(death.back_after_ms.unwrap() > 100.0, "{death:?}");
    }
    assert_replayed(&rig);
    sleep(Duration::from_millis(100));
    rig.assert_nothing_left();
}

/// What roles are started with by hand: a flight in slow motion.
fn by_hand(rig: &Rig) -> String {
    format!("--rt off --config {} --duration 10s", rig.slow(20))
}

fn others(rig: &Rig, args: &str) -> BTreeMap<&'static str, Running> {
    ["outer", "inner", "mixer", "record"]
        .map(|role| (role, rig.start(role, args)))
        .into()
}

/// Interrupts the plant, with which all others land.
fn land(plant: Running, others: BTreeMap<&'static str, Running>) {
    plant.signal(Signal::INT);
    plant.end().expect(0).complains("flight interrupted");
    for (role, process) in others {
        process.end().expect(if role == "record" { 130 } else { 0 });
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_is_killed_and_restarted_leaves_no_role_behind_and_its_successor_flies() {
    for after_ms in [0, 10, 100, 500, 1200, 3000] {
        let rig = Rig::new("again");
        let args = by_hand(&rig);
        let (plant, left) = (rig.start("plant", &args), others(&rig, &args));
        rig.await_flight();
        plant.signal(Signal::KILL);
        plant.end();
        sleep(Duration::from_millis(after_ms));
        let plant = rig.start("plant", &args);
        for (role, process) in left {
            let ended = process.end().expect(1);
            let says = |why| ended.stderr.contains(why);
            assert!(
                role == "record"
                    || says("another run has begun")
                    || says("the plant died in flight"),
                "after {after_ms} ms: {ended}"
            );
        }
        // It knows that everybody of the run before is gone.
        plant.await_words("waiting for outer, inner, mixer, record");
        let next = others(&rig, &args);
        rig.await_flight();
        land(plant, next);
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_cannot_be_joined_late_and_says_so() {
    let rig = Rig::new("late");
    let args = "--pace lockstep --duration 10h";
    let (plant, mut others) = (rig.start("plant", args), others(&rig, args));
    rig.await_flight();
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::KILL);
    inner.end();
    rig.run("inner", args).expect(1).complains(
        "the flight in lockstep has begun without this inner process, and cannot be joined late",
    );
    plant.end().expect(1).complains("a stage hangs or has died");
    others.into_values().for_each(|other| drop(other.end()));
}

#[test]
fn a_role_that_dies_as_the_run_opens_is_missed_by_name() {
    let rig = Rig::new("missed");
    let args = by_hand(&rig);
    let plant = rig.start("plant", &args);
    let mut others: BTreeMap<_, _> = ["outer", "inner", "record"]
        .map(|role| (role, rig.start(role, &args)))
        .into();
    plant.await_words("waiting for mixer (each");
    // Ready, and stopped before the run can open: it never arms.
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::STOP);
    others.insert("mixer", rig.start("mixer", &args));
    plant.await_words("waiting for inner to arm");
    inner.signal(Signal::KILL);
    inner.end();
    let said = plant.stderr().len();
    wait_until("the plant to say who is missing", || {
        plant.stderr()[said..]
            .contains("waiting for inner (each")
            .then_some(())
    });
    others.insert("inner", rig.start("inner", &args));
    rig.await_flight();
    land(plant, others);
    rig.assert_nothing_left();
}

#[test]
fn too_few_inodes_are_named_with_the_remedy() {
    let rig = Rig::new("inodes");
    for inodes in [2, 3, 4, 6, 9, 12] {
        let mount = format!("mount -t tmpfs -o size=256m,nr_inodes={inodes} tmpfs /dev/shm");
        let Some(mut plant) = in_own_mounts(&mount, "true", rig::IRONBIRD) else {
            return;
        };
        plant.arg("plant").args(rig.own_args("plant", "--rt off"));
        plant.env("IRONBIRD_ROOT", rig.root());
        let plant = rig.launch(plant).end();
        assert!(
            matches!(plant.code, Some(1 | 2)),
            "{inodes} inodes: {plant}"
        );
        assert!(
            !plant.stderr.contains("ironbird clean"),
            "{inodes} inodes: {plant}"
        );
        plant.complains("/dev/shm");
    }
}
