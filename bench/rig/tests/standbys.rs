//! Standbys: processes that wait beside the stages of a flight, and take the place of one that dies.

use crate::restarts::{assert_replayed, await_successor, report, strike, take_off};
use crate::rig::{Rig, files_below, is_gone, send, wait_until};
use messages::role::Role;
use process::standby::NAME;
use report::schema::ProcessFailure;
use rustix::process::Signal;
use std::fs;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A flight in slow motion, so that none of it is lost where the machine is busy.
const SLOWDOWN: u64 = 4;

const WITH_STANDBYS: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];

fn by_standby(death: &ProcessFailure) -> bool {
    death
        .back_parts
        .as_ref()
        .unwrap_or_else(|| panic!("cause of the end unknown it came back: {death:?}"))
        .spare
}

#[test]
fn a_standby_takes_the_place_of_a_stage_that_dies_and_another_one_waits() {
    let rig = Rig::new("takes");
    // The law of a file is loaded and made in the standby, and flies from there.
    let law = crate::c_laws::cascade(&rig);
    let options = ["--rt", "prefer", "--duration", "6s", "--inner", &law];
    let (flight, run) = take_off(&rig, SLOWDOWN, &options);
    for (i, role) in WITH_STANDBYS.into_iter().enumerate() {
        let standby = rig.await_standby(role, None);
        let dead = strike(&rig, &run, 400 + 300 * i as u64, role, Signal::KILL);
        assert_eq!(
            await_successor(&rig, role, dead),
            standby,
            "the process that waited flies"
        );
        rig.await_standby(role, Some(standby));
    }
    let ended = flight.end().expect(0);
    for role in WITH_STANDBYS {
        let said = format!(
            "the {role} process died: signal: 9 (SIGKILL); it is started again: its hot standby takes over"
        );
        assert!(ended.stderr.contains(&said), "{ended}");
        let log = fs::read_to_string(rig.out().join(format!("latest/{role}.log"))).unwrap();
        let says = |word| log.contains(word);
        assert!(!says("spare") && !says("standby"), "{log}");
    }
    let report = report(&rig);
    assert_eq!(report.deaths.len(), 3, "{:?}", report.deaths);
    for death in &report.deaths {
        assert!(by_standby(death), "{death:?}");
        let parts = death.back_parts.as_ref().unwrap();
        let sum = parts.sum_ms();
        // From the beginning of one tick to that of another; messages are sent within them.
        let ticks_ms = (death.ticks_lost.unwrap() + 1) as f64 * SLOWDOWN as f64;
        assert!(
            (sum - ticks_ms).abs() < 0.01,
            "the parts {parts:?} are {sum} ms of {ticks_ms} ms"
        );
    }
    rig.ok("report --section deaths")
        .says("    a spare [ms]: noticed ");
    assert_replayed(&rig);
    rig.assert_nothing_left();
}

#[test]
fn a_standby_that_is_killed_is_no_death_of_the_flight_and_has_a_successor() {
    let rig = Rig::new("killed");
    let (flight, run) = take_off(&rig, SLOWDOWN, &["--rt", "off", "--duration", "4s"]);
    let [_, first, _] = WITH_STANDBYS.map(|role| rig.await_standby(role, None));
    // Names change with each process; what there is of each kind does not.
    let held = || (rig.segments().len(), files_below(&rig.root()).len());
    let before = held();
    send(first, Signal::KILL);
    let second = rig.await_standby(Role::Inner, Some(first));
    assert!(is_gone(first));
    assert_eq!(held(), before, "what the killed one held is removed");
    let dead = strike(&rig, &run, 0, Role::Inner, Signal::KILL);
    assert_eq!(await_successor(&rig, Role::Inner, dead), second);
    flight.end().expect(0);
    let report = report(&rig);
    assert_eq!(report.deaths.len(), 1, "{:?}", report.deaths);
    assert_replayed(&rig);
    rig.assert_nothing_left();
}

/// Waits, without a pause, until a standby goes on: it takes another name then, and has no place yet.
fn await_on_its_way(standby: u32) {
    let begun = Instant::now();
    while fs::read_to_string(format!("/proc/{standby}/comm"))
        .unwrap()
        .trim_end()
        .as_bytes()
        == NAME.to_bytes()
    {
        assert!(
            begun.elapsed() < Duration::from_secs(30),
            "the standby does not go on"
        );
    }
}

#[test]
fn a_standby_that_is_to_end_as_it_goes_on_ends_and_the_flight_with_it() {
    let rig = Rig::new("ends");
    let (flight, run) = take_off(&rig, SLOWDOWN, &["--rt", "off", "--duration", "60s"]);
    let standby = rig.await_standby(Role::Inner, None);
    strike(&rig, &run, 0, Role::Inner, Signal::KILL);
    await_on_its_way(standby);
    send(standby, Signal::TERM);
    let ended = flight.end();
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    assert!(is_gone(standby));
    rig.assert_nothing_left();
}

#[test]
fn a_standby_that_is_stopped_on_its_way_is_killed_and_another_process_comes() {
    let rig = Rig::new("way");
    let (flight, run) = take_off(&rig, SLOWDOWN, &["--rt", "off", "--duration", "6s"]);
    // Of an inner loop, five in ten seconds are started again.
    for (i, wait_us) in [0, 1500].into_iter().enumerate() {
        let standby = rig.await_standby(Role::Inner, None);
        let dead = strike(&rig, &run, 300 + 400 * i as u64, Role::Inner, Signal::KILL);
        await_on_its_way(standby);
        sleep(Duration::from_micros(wait_us));
        send(standby, Signal::STOP);
        wait_until("the stopped process to go", || {
            is_gone(standby).then_some(())
        });
        wait_until("another process to fly", || {
            (await_successor(&rig, Role::Inner, dead) != standby).then_some(())
        });
    }
    let begun = Instant::now();
    flight.end();
    assert!(
        begun.elapsed() < Duration::from_secs(55),
        "the flight takes 24 s of the clock: {:?}",
        begun.elapsed()
    );
    rig.assert_nothing_left();
}

#[test]
fn a_standby_that_fails_is_reported_and_costs_the_flight_nothing() {
    let rig = Rig::new("fails");
    let config = crate::c_laws::misbehaving(&rig, "refuse_with_file", 0);
    let flight = rig.start(
        "fly",
        format!("--on-death restart --rt off --config {config} --duration 4s"),
    );
    let standby = rig.await_standby(Role::Inner, None);
    fs::write(rig.path("refuse"), "").unwrap();
    send(standby, Signal::KILL);
    let ended = flight
        .end()
        .expect(0)
        .complains(" no longer has a hot standby: it ended with exit status: ");
    assert_eq!(ended.result()["deaths"], "0", "{ended}");
    let log = fs::read_to_string(rig.out().join("latest/inner.log")).unwrap();
    assert!(log.contains("there is a file named refuse"), "{log}");
    rig.assert_nothing_left();
}

#[test]
fn successors_that_send_nothing_are_reported_within_the_death_that_they_were_to_make_good() {
    let rig = Rig::new("silent");
    let config = crate::c_laws::misbehaving(&rig, "refuse_with_file", 0);
    let settings = fs::read_to_string(&config).unwrap();
    let slow = format!("[flight]\nslowdown = {SLOWDOWN}\n");
    fs::write(&config, settings.replace("[flight]\n", &slow)).unwrap();
    let flight = rig.start(
        "fly",
        format!("--on-death restart --rt off --config {config} --duration 3s"),
    );
    let (run, standby) = (rig.await_tick(0), rig.await_standby(Role::Inner, None));
    // From now on the law refuses, and with it each that is to take the place of the inner loop.
    fs::write(rig.path("refuse"), "").unwrap();
    send(standby, Signal::KILL);
    wait_until("the standby to go", || is_gone(standby).then_some(()));
    strike(&rig, &run, 0, Role::Inner, Signal::KILL);
    let ended = flight
        .end()
        .complains("the inner process died: exit status: 2; it is started again");
    assert_eq!(
        (&*ended.result()["status"], &*ended.result()["deaths"]),
        ("ABORTED", "6"),
        "{ended}"
    );
    let report = report(&rig);
    let [death, silent @ ..] = &report.deaths[..] else {
        panic!("{ended}")
    };
    assert!(
        death.ticks_lost.is_some() && death.back_after_ms.is_none() && death.within.is_none(),
        "{death:?}"
    );
    let line = format!(
        ", before its first message: its ticks are those lost at tick {}",
        death.tick
    );
    for silent in silent {
        assert_eq!(
            (silent.epoch, silent.within),
            (0, Some(death.tick)),
            "{silent:?}"
        );
        assert!(silent.line().ends_with(&line), "{}", silent.line());
    }
    rig.assert_nothing_left();
}

#[test]
fn there_are_no_standbys_where_nobody_is_restarted() {
    let rig = Rig::new("end");
    let slow = rig.slow(SLOWDOWN);
    let flight = rig.take_off(format!("--rt off --config {slow} --duration 1s"));
    for tick in (0..900).step_by(100) {
        rig.await_tick(tick);
        assert_eq!(rig.processes_of("inner").len(), 1);
    }
    flight.end().expect(0);
}
