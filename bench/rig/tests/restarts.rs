//! Roles that are killed and started again: every role of a rig ends or flies, and says why. None waits for ever.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::rig::{Ended, Rig, Running, rounds, wait_until};
use rustix::process::Signal;

const OTHERS: [&str; 4] = ["outer", "inner", "mixer", "record"];
/// Longest that a role may take to end when its plant is gone; a rig that hangs waits for ever.
const BOUND: Duration = Duration::from_secs(30);

/// What roles are started with by hand: a flight in slow motion that nobody outlives.
fn by_hand(rig: &Rig) -> Vec<String> {
    ["--rt", "off", "--config", &rig.slow(20), "--duration", "10s"].map(str::to_owned).into()
}

fn start(rig: &Rig, role: &str, args: &[String]) -> Running {
    rig.start(role, &args.iter().map(String::as_str).collect::<Vec<_>>())
}

/// All five roles, in the air.
fn crew_in_the_air(rig: &Rig, args: &[String]) -> (Running, BTreeMap<&'static str, Running>) {
    let others = OTHERS.map(|role| (role, start(rig, role, args))).into();
    let plant = start(rig, "plant", args);
    rig.await_flight();
    (plant, others)
}

/// Ends of processes within the bound; those that hang are none.
fn ends(mut running: BTreeMap<&'static str, Running>) -> BTreeMap<&'static str, Option<Ended>> {
    let until = Instant::now() + BOUND;
    while Instant::now() < until && running.values_mut().any(Running::is_running) {
        sleep(Duration::from_millis(20));
    }
    running.into_iter().map(|(role, mut it)| (role, (!it.is_running()).then(|| it.end()))).collect()
}

/// Waits until the plant knows that everybody of the run before is gone.
fn await_waiting_for_all(plant: &Running) {
    plant.await_words("waiting for outer, inner, mixer, record");
}

/// Kills the plant in flight and starts it again: the others must end, and say why; the new one flies with a new crew.
fn restart_the_plant(after: Duration) -> BTreeMap<&'static str, String> {
    let rig = Rig::new("again");
    let args = by_hand(&rig);
    let (plant, others) = crew_in_the_air(&rig, &args);
    plant.signal(Signal::KILL);
    plant.end();
    sleep(after);
    let mut plant = start(&rig, "plant", &args);
    let mut outcomes = BTreeMap::new();
    for (role, ended) in ends(others) {
        let ended = ended.unwrap_or_else(|| panic!("{role} hangs when the plant is started again after {after:?}"));
        assert_eq!(ended.code, Some(1), "{role}, after {after:?}: {ended}");
        outcomes.insert(role, ended.stderr);
    }
    await_waiting_for_all(&plant);
    assert!(plant.is_running());
    let crew: BTreeMap<_, _> = OTHERS.map(|role| (role, start(&rig, role, &args))).into();
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(crew) {
        let expected = if role == "record" { 130 } else { 0 };
        ended.unwrap_or_else(|| panic!("{role} does not land")).expect(expected);
    }
    rig.assert_nothing_left();
    outcomes
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_is_killed_and_started_again_leaves_no_role_behind() {
    for after_ms in [0, 10, 100, 500, 1200, 3000] {
        for (role, said) in restart_the_plant(Duration::from_millis(after_ms)) {
            let told = ["another run has begun", "the plant died in flight"].iter().any(|why| said.contains(why));
            assert!(told || role == "record", "after {after_ms} ms {role} said: {said}");
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_is_killed_before_the_flight_is_waited_for_and_its_successor_flies() {
    let rig = Rig::new("early");
    let args = by_hand(&rig);
    let plant = start(&rig, "plant", &args);
    plant.await_words("waiting for outer");
    // All but one: they wait for the plant to open the run.
    let mut others: BTreeMap<_, _> = ["inner", "mixer", "record"].map(|role| (role, start(&rig, role, &args))).into();
    plant.await_words("waiting for outer (each");
    plant.signal(Signal::KILL);
    plant.end();
    others.insert("outer", start(&rig, "outer", &args));
    others["outer"].await_words("waiting for the plant (`ironbird plant`)");
    let plant = start(&rig, "plant", &args);
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    assert!(ends(others).values().all(Option::is_some));
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_role_that_is_started_while_the_plant_flies_joins_it_and_its_successor_has_its_place() {
    let rig = Rig::new("joiner");
    let args = by_hand(&rig);
    let (plant, mut others) = crew_in_the_air(&rig, &args);
    for signal in [Signal::KILL, Signal::KILL] {
        let inner = others.remove("inner").unwrap();
        inner.signal(signal);
        inner.end();
        let before = rig.run("params", &["--json"]).expect(0).json()[0]["in_force"].clone();
        assert!(!before.is_null());
        others.insert("inner", start(&rig, "inner", &args));
        // It works ticks of the present, and so the flight goes on: nobody asks for its end.
        sleep(Duration::from_millis(500));
        assert!(others.values_mut().all(Running::is_running), "{}", others["inner"].stderr());
    }
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(others) {
        ended.unwrap_or_else(|| panic!("{role} does not land")).expect(if role == "record" { 130 } else { 0 });
    }
    let inner = &rig.report()["roles"]["inner"];
    assert!(inner["landed"] == true && inner["ticks_run"].as_u64().unwrap() > 10, "{inner}");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_cannot_be_joined_late_and_says_so() {
    let rig = Rig::new("late");
    let args: Vec<String> = ["--pace", "lockstep", "--duration", "10h"].map(str::to_owned).into();
    let (plant, mut others) = crew_in_the_air(&rig, &args);
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::KILL);
    inner.end();
    let late = start(&rig, "inner", &args).end().expect(1);
    late.complains("the flight in lockstep has begun without this inner process, and cannot be joined late");
    plant.end().expect(1).complains("a stage hangs or has died");
    assert!(ends(others).values().all(Option::is_some));
}

#[test]
fn a_role_that_dies_as_the_run_opens_is_missed_by_name() {
    let rig = Rig::new("missed");
    let args = by_hand(&rig);
    let plant = start(&rig, "plant", &args);
    let mut others: BTreeMap<_, _> = ["outer", "inner", "record"].map(|role| (role, start(&rig, role, &args))).into();
    plant.await_words("waiting for mixer (each");
    // Ready, and stopped before the run can open: it never arms.
    let inner = others.remove("inner").unwrap();
    inner.signal(Signal::STOP);
    others.insert("mixer", start(&rig, "mixer", &args));
    plant.await_words("waiting for inner to arm");
    inner.signal(Signal::KILL);
    inner.end();
    let said = plant.stderr().len();
    wait_until("the plant to say who is missing", || {
        plant.stderr()[said..].contains("waiting for inner (each").then_some(())
    });
    others.insert("inner", start(&rig, "inner", &args));
    rig.await_flight();
    plant.signal(Signal::INT);
    plant.end().expect(0);
    for (role, ended) in ends(others) {
        assert!(ended.is_some(), "{role} hangs when the flight is over");
    }
    rig.assert_nothing_left();
}

/// Kills a launcher, starts another one after a while, and says how that one ended.
fn relaunch(rig: &Rig, after: Duration) -> String {
    let slow = rig.slow(5);
    let args = ["--rt", "off", "--config", &slow, "--duration", "100ms"];
    let first = rig.take_off(&["--rt", "off", "--config", &slow, "--duration", "60s"]);
    let roles = first.roles();
    first.signal(Signal::KILL);
    first.end();
    sleep(after);
    let mut second: BTreeMap<_, _> = [("fly", rig.start("fly", &args))].into();
    let until = Instant::now() + BOUND;
    while second.values_mut().any(Running::is_running) && Instant::now() < until {
        sleep(Duration::from_millis(20));
    }
    let mut second = second.remove("fly").unwrap();
    if second.is_running() {
        return "HANGS".into();
    }
    let ended = second.end();
    for pid in roles.into_values() {
        wait_until(&format!("process {pid} to end"), || rig::is_gone(pid).then_some(()));
    }
    match ended.code {
        Some(0) => ended.result()["status"].clone(),
        Some(5) => {
            assert!(ended.stderr.contains("already has a running"), "{ended}");
            "code 5, an old role still leaves".into()
        }
        code => {
            let why = ended.stderr.lines().find(|line| line.contains('×')).unwrap_or(&ended.stderr).trim().to_owned();
            format!("code {code:?}: {why}")
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_launcher_that_is_killed_and_started_again_flies_or_says_who_is_in_its_place() {
    for after_ms in [0, 20, 50, 100, 200, 300] {
        let outcome = relaunch(&Rig::new("relaunch"), Duration::from_millis(after_ms));
        assert!(outcome == "PASS" || outcome.starts_with("code 5"), "after {after_ms} ms: {outcome}");
    }
}

fn print(what: &str, counts: &BTreeMap<String, u64>) {
    let mut out = std::io::stderr().lock();
    writeln!(out, "{what}:").unwrap();
    counts.iter().for_each(|(outcome, count)| writeln!(out, "{count:6}  {outcome}").unwrap());
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn soak_of_plants_started_again() {
    let mut counts = BTreeMap::new();
    for round in 0..rounds() {
        let after = Duration::from_millis(round * 37 % 1500);
        for (role, said) in restart_the_plant(after) {
            let known =
                ["another run has begun", "the plant died in flight"].into_iter().find(|why| said.contains(why));
            let outcome =
                known.map_or_else(|| format!("says: {}", said.lines().last().unwrap_or("nothing")), Into::into);
            *counts.entry(format!("{role}: {outcome}")).or_default() += 1;
        }
    }
    print("roles of a plant that was killed and started again", &counts);
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn soak_of_launchers_started_again() {
    let mut counts = BTreeMap::new();
    for round in 0..rounds() {
        let after = Duration::from_millis(round * 37 % 300);
        *counts.entry(relaunch(&Rig::new("soak"), after)).or_default() += 1;
    }
    print("launchers that were started again", &counts);
    assert!(!counts.contains_key("HANGS"), "{counts:?}");
}
