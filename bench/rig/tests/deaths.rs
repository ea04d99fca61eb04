//! `fly --on-death restart`: processes that die or hang in flight come back, or the flight ends and says why.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;
use std::thread::sleep;
use std::time::Duration;

use crate::rig::{Rig, Running, is_gone, not_tested, process_of, rounds, send, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use flight_log::reader::End;
use ironbird::fly::signal_at::send_at;
use model::boards::{RUN, RolePhase, Run, RunPhase, Status};
use model::messages::NO_TICK;
use model::role::Role;
use report::deaths::Death;
use report::schema::Report;
use role::station::status_board;
use rustix::process::Signal;
use wire::Wire;

/// What every flight here is flown with.
pub(crate) const RESTART: [&str; 4] = ["--on-death", "restart", "--trajectory", "hover"];

/// Settings of slow motion without a ground: whoever hovers at its height falls through it while a stage is missing.
pub(crate) fn in_the_air(rig: &Rig, slowdown: u64) -> String {
    rig.settings(&format!("[flight]\nslowdown = {slowdown}\nground_z_m = -100.0\n"))
}

/// A flight in the air, and what its plant says of it.
pub(crate) fn take_off(rig: &Rig, slowdown: u64, args: &[&str]) -> (Running, Run) {
    let config = in_the_air(rig, slowdown);
    let flight = rig.start("fly", &[&RESTART[..], &["--config", &config], args].concat());
    (flight, await_first_tick(rig))
}

pub(crate) fn await_first_tick(rig: &Rig) -> Run {
    let wire = Wire::open(&rig.known()).unwrap();
    wait_until("the first tick", || {
        let run = wire.board_reader::<Run>(RUN).unwrap()?.get();
        (run.phase() == RunPhase::Flying && run.tick != NO_TICK).then_some(run)
    })
}

/// Sends a signal to a role at a tick; its process.
pub(crate) fn strike(rig: &Rig, run: &Run, tick: u64, role: Role, signal: Signal) -> u32 {
    send_at(&rig.known(), run, tick, role, signal).unwrap()
}

/// Waits until another process than this one flies in a role.
pub(crate) fn await_successor(rig: &Rig, role: Role, dead: u32) -> u32 {
    let wire = Wire::open(&rig.known()).unwrap();
    let pid = wait_until(&format!("another {role} process to fly"), || {
        let status = wire.board_reader::<Status>(&status_board(role)).unwrap()?.get();
        (status.phase() == RolePhase::Flying && status.pid != u64::from(dead) && status.ticks_run > 0)
            .then_some(status.pid)
    });
    u32::try_from(pid).unwrap()
}

pub(crate) fn report(rig: &Rig) -> Report {
    Report::read(&rig.out().join("latest/report.json")).unwrap()
}

/// The replay has every bit of the record.
pub(crate) fn assert_replayed(rig: &Rig) {
    rig.run("replay", &["--verify"]).expect(0).says("identical");
}

/// What every death that was survived has in the report.
fn assert_survived(death: &Death, role: Role, how: &str) {
    assert_eq!((death.role.as_str(), death.how.as_str()), (role.name(), how), "{death:?}");
    assert!(death.epoch > 0 && death.noticed_after_ms.unwrap() > 0.0, "{death:?}");
    assert!(death.back_after_ms.unwrap() > 0.0 && death.ticks_lost.unwrap() > 0, "{death:?}");
    assert!(death.position_error_max_m.unwrap() > 0.0, "{death:?}");
}

/// Kills a role once in a flight, and demands that it comes back, is told of, and is replayed.
fn kill_once(role: Role, rt: &str, tick: u64) {
    let rig = Rig::new("once");
    let (flight, run) = take_off(&rig, 1, &["--rt", rt, "--duration", "4s"]);
    strike(&rig, &run, tick, role, Signal::KILL);
    let ended = flight.end().expect(0);
    let said = format!("the {role} process died: signal: 9 (SIGKILL); it is started again");
    let ended = ended.complains(&said).says(&format!("\nDeaths    {role} at tick "));
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert_eq!(ended.result()["deaths"], "1", "{ended}");
    let report = report(&rig);
    if rt == "prefer" && report.roles["inner"].scheduling == "other" {
        not_tested("SCHED_FIFO was not granted");
    }
    let [death] = &report.deaths[..] else { panic!("{:?}", report.deaths) };
    assert_survived(death, role, "signal: 9 (SIGKILL)");
    // Neither the signal nor the stage is always in time.
    assert!(death.tick.abs_diff(tick) <= 200, "killed in tick {tick}: {death:?}");
    let named = |case: &&report::autopsy::section::Case| {
        case.stage.as_deref() == Some(role.name()) && case.evidence.contains("has ended, and process ")
    };
    assert!(report.autopsy.worst.iter().any(|case| named(&case)), "{}", report.autopsy.text());
    assert_eq!(report.ticks.run + report.ticks.skipped, 4001);
    rig.run("report", &["--section", "deaths"]).expect(0).says(&format!("  {role} at tick {}", death.tick));
    assert!(fs::read_to_string(rig.out().join("latest/report.html")).unwrap().contains(&death.line()));
    assert_replayed(&rig);
    rig.assert_nothing_left();
}

#[test]
fn an_inner_loop_that_is_killed_comes_back_and_its_flight_is_replayed() {
    kill_once(Role::Inner, "off", 1500);
}

#[test]
#[ignore = "long: part of the gate"]
fn each_stage_that_is_killed_comes_back_however_it_is_scheduled() {
    for (i, role) in [Role::Outer, Role::Inner, Role::Mixer].into_iter().enumerate() {
        for (j, rt) in ["off", "prefer"].into_iter().enumerate() {
            kill_once(role, rt, 1200 + 97 * (2 * i + j) as u64);
        }
    }
}

/// The estimates of all wrenches of a flight's log, with the epoch of each.
fn estimates(rig: &Rig) -> Vec<(u64, [f64; 3])> {
    let (entries, _) = rig::read_log(&rig.out().join("latest/flight.mcap"));
    let wrench = |entry: &LogEntry| match entry {
        LogEntry::Wrench(message) => Some((message.envelope.epoch, estimate(&message.content.telemetry))),
        _ => None,
    };
    entries.iter().filter_map(wrench).collect()
}

#[test]
#[ignore = "long: part of the gate"]
fn an_inner_loop_begins_at_its_priors_or_where_its_predecessor_was() {
    for resumes in [false, true] {
        let rig = Rig::new("resumes");
        let flags = ["--rt", "off", "--duration", "4s", "--trajectory", "lissajous", "--resume-estimates"];
        let flight = rig.start("fly", &[&RESTART[..2], &flags[..if resumes { 7 } else { 6 }]].concat());
        let run = await_first_tick(&rig);
        strike(&rig, &run, 2500, Role::Inner, Signal::KILL);
        flight.end().expect(0);
        let estimates = estimates(&rig);
        let begin = estimates.windows(2).position(|pair| pair[0].0 != pair[1].0).unwrap() + 1;
        let (before, first) = (&estimates[begin - 2..begin], estimates[begin].1);
        let (prior, is_taken_over) = (estimates[0].1, before.iter().any(|(_, last)| *last == first));
        assert_eq!((is_taken_over, first == prior), (resumes, !resumes), "{before:?} -> {first:?}");
        let said = fs::read_to_string(rig.out().join("latest/inner.log")).unwrap();
        assert_eq!(said.contains("begins with the last estimates"), resumes, "{said}");
        assert_replayed(&rig);
    }
}

/// Kills stages in turns at random phases of their ticks; a flight in slow motion, so that none is lost of it.
fn kills_in_a_row(kills: u64) {
    const TICK_MS: u64 = 4;
    // Of each role one in 2.1 s: five in ten seconds are borne.
    const APART_TICKS: u64 = 700 / TICK_MS;
    let rig = Rig::new("row");
    let seconds = (kills * APART_TICKS + 500).div_ceil(1000);
    let (flight, mut run) = take_off(&rig, TICK_MS, &["--rt", "off", "--duration", &format!("{seconds}s")]);
    let t0_ns = run.t0_ns;
    for kill in 0..kills {
        let role = [Role::Inner, Role::Mixer, Role::Outer][kill as usize % 3];
        // Within the tick, everywhere in the course of the kills.
        run.t0_ns = t0_ns + kill.wrapping_mul(2_654_435_761) % run.period_ns;
        let dead = strike(&rig, &run, 100 + kill * APART_TICKS, role, Signal::KILL);
        await_successor(&rig, role, dead);
    }
    flight.end().expect(0);
    let report = report(&rig);
    assert_eq!(report.deaths.len() as u64, kills, "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(death.how == "signal: 9 (SIGKILL)" && death.back_after_ms.is_some(), "{death:?}");
    }
    assert_eq!(report.run.ending, "completed");
    assert_replayed(&rig);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn twenty_kills_at_random_phases_are_survived_and_replayed() {
    kills_in_a_row(20 * rounds());
}

#[test]
#[ignore = "long: part of the gate"]
fn a_sixth_death_within_ten_seconds_ends_the_flight() {
    let rig = Rig::new("often");
    let (flight, run) = take_off(&rig, 5, &["--rt", "off", "--duration", "60s"]);
    let mut dead = strike(&rig, &run, 0, Role::Inner, Signal::KILL);
    for _ in 0..5 {
        let next = await_successor(&rig, Role::Inner, dead);
        send(next, Signal::KILL);
        dead = next;
    }
    let ended = flight.end().expect(1);
    assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
    let ended = ended.tells("it has been started again 5 times within 10 s, which is the most");
    let report = report(&rig);
    assert_eq!(report.deaths.len(), 6, "{ended}");
    let last = report.deaths.last().unwrap();
    assert!(last.back_after_ms.is_none() && last.ticks_lost.is_some(), "{last:?}");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_stage_that_hangs_is_killed_and_comes_back() {
    for role in [Role::Outer, Role::Inner, Role::Mixer] {
        let rig = Rig::new("hangs");
        let (flight, run) = take_off(&rig, 1, &["--rt", "off", "--duration", "4s"]);
        let stopped = strike(&rig, &run, 1000, role, Signal::STOP);
        await_successor(&rig, role, stopped);
        assert!(is_gone(stopped), "nobody has to wake it up");
        flight.end().expect(0).complains(&format!("the {role} process hung, and was killed; it is started again"));
        let report = report(&rig);
        let [death] = &report.deaths[..] else { panic!("{:?}", report.deaths) };
        assert_survived(death, role, "hung, and was killed");
        // The heartbeat stands still for that long before anybody is killed.
        assert!(death.noticed_after_ms.unwrap() > 80.0, "{death:?}");
        assert_replayed(&rig);
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_dies_or_hangs_ends_the_flight_which_says_so() {
    for (signal, how) in [(Signal::KILL, "died: signal: 9 (SIGKILL)"), (Signal::STOP, "hung, and was killed")] {
        let rig = Rig::new("plant");
        let (flight, run) = take_off(&rig, 1, &["--rt", "off", "--duration", "60s"]);
        wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
        strike(&rig, &run, 0, Role::Plant, signal);
        let ended = flight.end().expect(1);
        assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
        let ended = report(&rig).run.ending;
        assert!(ended.starts_with(&format!("the plant process {how}; a plant cannot be started again in flight")));
        assert_eq!(report(&rig).deaths.iter().filter(|death| death.role == "plant").count(), 1);
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_goes_on_without_its_recorder_and_another_one_records_the_rest() {
    let rig = Rig::new("recorder");
    let (flight, run) = take_off(&rig, 1, &["--rt", "off", "--duration", "6s"]);
    wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
    strike(&rig, &run, 2000, Role::Record, Signal::KILL);
    let ended = flight.end().expect(0);
    assert_eq!(ended.result()["status"], "INCOMPLETE", "{ended}");
    let [first, second] = <[String; 2]>::try_from(rig.run_directories()).unwrap();
    let rest = report(&rig);
    assert_eq!(rest.ticks.run + rest.ticks.skipped, 6001);
    let [death] = &rest.deaths[..] else { panic!("{:?}", rest.deaths) };
    assert_eq!((death.role.as_str(), death.how.as_str()), ("record", "signal: 9 (SIGKILL)"));
    assert!((1900..4000).contains(&death.tick), "{death:?}");
    rig.run("report", &[&first, "--section", "head"])
        .expect(0)
        .tells(&format!("the recorder died; the flight went on, and another recorder wrote {second}"));
    let (kept, end) = rig::read_log(&rig.out().join(&first).join("flight.mcap"));
    assert!(end == End::Truncated && kept.len() > 1000, "{} messages, {end:?}", kept.len());
    rig.assert_nothing_left();
}

#[test]
fn in_lockstep_nobody_can_join_a_flight_and_so_nobody_is_started_again() {
    let rig = Rig::new("lockstep");
    let refused = rig.run("fly", &["--on-death", "restart", "--pace", "lockstep"]).expect(2);
    refused.complains("--on-death restart has no meaning in lockstep");
    rig.assert_nothing_started();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_role_that_dies_in_a_flight_that_ends_with_it_is_in_the_report_too() {
    let rig = Rig::new("end");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(5), "--duration", "60s"]);
    wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
    send(flight.roles()["mixer"], Signal::KILL);
    flight.end().expect(1).says(&format!("the {} died", process_of("mixer")));
    let report = report(&rig);
    let [death] = &report.deaths[..] else { panic!("{:?}", report.deaths) };
    assert_eq!((death.role.as_str(), death.how.as_str()), ("mixer", "signal: 9 (SIGKILL)"));
    assert_eq!(death.back_after_ms, None);
}

/// The five roles as systemd would have them: each is started again 100 ms after it has failed.
#[test]
#[ignore = "long: part of the gate"]
fn roles_that_somebody_else_starts_again_are_reported_and_replayed_alike() {
    let rig = Rig::new("unit");
    let config = in_the_air(&rig, 2);
    let options = ["--rt", "off", "--config", &config, "--trajectory", "hover", "--duration", "2s"];
    // What examples/systemd/ironbird@.service says: Restart=on-failure, RestartSec=100ms, SuccessExitStatus=130 3.
    let kept = |role: &str| {
        let command = rig.command(role, &options);
        let mut keeper = std::process::Command::new("sh");
        let forever = "until \"$@\" || case $? in 3|130) ;; *) false ;; esac; do sleep 0.1; done";
        keeper.args(["-c", forever, "sh"]);
        keeper.arg(command.get_program()).args(command.get_args()).env("IRONBIRD_ROOT", rig.root());
        rig.launch(keeper)
    };
    let keepers = ["outer", "inner", "mixer", "record", "plant"].map(kept);
    rig.await_flight();
    let wire = Wire::open(&rig.known()).unwrap();
    let run = wire.board_reader::<Run>(RUN).unwrap().unwrap().get();
    drop(wire);
    for (role, tick) in [(Role::Inner, 400), (Role::Outer, 800), (Role::Mixer, 1200)] {
        let dead = strike(&rig, &run, tick, role, Signal::KILL);
        await_successor(&rig, role, dead);
    }
    keepers.into_iter().for_each(|keeper| drop(keeper.end().expect(0)));
    let report = report(&rig);
    let roles: Vec<&str> = report.deaths.iter().map(|death| death.role.as_str()).collect();
    assert_eq!(roles, ["inner", "outer", "mixer"], "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(death.how.is_empty() && death.noticed_after_ms.is_none(), "nobody told: {death:?}");
        // So long its keeper sleeps alone.
        assert!(death.back_after_ms.unwrap() > 100.0, "{death:?}");
    }
    assert_replayed(&rig);
    sleep(Duration::from_millis(100));
    rig.assert_nothing_left();
}
