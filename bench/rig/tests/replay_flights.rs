//! Replay of real flights in slow motion, with stages that are stopped and started again.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::thread::sleep;
use std::time::Duration;

use crate::rig::{Rig, stop_for, wait_until};
use model::role::Role;
use rustix::process::Signal;

/// Ticks of 10 ms, rotors that saturate, noise, and swaps.
const TROUBLED: &str = "[flight]\nslowdown = 10\ntrajectory = \"fast\"\nduration_s = 0.8\n\
    faults = [\"gyro_noise_rad_s=0.02@tick40\", \"rotor_efficiency_3=0.9@tick790\"]\n[rotor]\nmax_rad_s = 220.0\n";

#[track_caller]
fn verifies(rig: &Rig) {
    let verified =
        rig.run("replay", &["--verify"]).expect(0).complains(" s flown again in ").complains(" times real time)");
    let (ticks, said) = (rig.report()["ticks"]["run"].clone(), verified.stdout.clone());
    assert!(
        said.starts_with(&format!("replay: {ticks} ticks, ")) && said.contains(" values, identical; outputs "),
        "{said}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_whose_stages_are_stopped_one_after_the_other_is_identical() {
    let rig = Rig::new("replayed");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.settings(TROUBLED)]);
    let roles = flight.roles();
    for (role, ms) in [("outer", 100), ("inner", 60), ("mixer", 23), ("plant", 40), ("plant", 430), ("mixer", 300)] {
        sleep(Duration::from_millis(120));
        stop_for(roles[role], Duration::from_millis(ms));
    }
    rig.run("inject", &["mass_kg=0.55", "rotational_drag_nm_s=0.2"]);
    flight.end();
    let report = rig.report();
    let number = |section: &str, key: &str| report[section][key].as_u64().unwrap();
    assert!(number("ticks", "skipped") > 10 && number("deadlines", "missed") > 10, "{report}");
    assert!(report["roles"]["inner"]["ticks_stale"].as_u64().unwrap() > 5, "{report}");
    verifies(&rig);
    rig.run("replay", &["--verify", "--from", "100"]).expect(0).says("identical");
    let told = rig.run("replay", &[]).expect(0);
    told.says("swap 1 at tick 40: gyro_noise_rad_s 0 -> 0.02").says("agrees with the record");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_stood_still_between_its_two_looks_at_the_commands_is_replayed() {
    let rig = Rig::new("twice");
    // Half of a tick lies between the two.
    let flight = rig.take_off(&["--trajectory", "hover", "--duration", "5s", "--lead", "500"]);
    let plant = flight.roles()["plant"];
    for i in 0..10 {
        // Longer than commands can wait; at other instants of a tick each time.
        stop_for(plant, Duration::from_millis(90));
        sleep(Duration::from_micros(180_000 + 300 * i));
    }
    flight.end();
    assert!(rig.report()["ticks"]["skipped"].as_u64().unwrap() > 500);
    verifies(&rig);
}

#[test]
fn a_rehearsed_flight_is_identical_and_says_how_often_it_was_rehearsed() {
    let rig = Rig::new("rehearsed");
    let settings = rig.settings(TROUBLED);
    let fly = |lead: &str| {
        rig.run("fly", &["--rt", "off", "--config", &settings, "--lead", lead]);
        rig.report()["lead"].clone()
    };
    let lead = fly("4000");
    for key in ["lead_us", "least_us", "median_us", "most_us"] {
        assert_eq!(lead[key], 4000.0, "a lead that is set stays: {key} of {lead}");
    }
    let number = |key: &str| lead[key].as_f64().unwrap();
    assert!(number("rehearsals") > 0.0 && number("rehearsal_us") > 0.0 && number("processor_percent") > 0.0, "{lead}");
    assert!(rig.report()["ticks"]["run"].as_f64().unwrap() >= number("rehearsals"), "{lead}");
    verifies(&rig);
    let told = rig.run("report", &["--section", "processes"]).expect(0);
    told.says("Lead 4000 us before the tick (before take-off: timer p90 ").says("; rehearsed ").says("; it took ");
    let none = fly("0");
    assert_eq!((none["lead_us"].as_f64(), none["rehearsals"].as_u64()), (Some(0.0), Some(0)));
    verifies(&rig);
    rig.run("report", &["--section", "processes"])
        .expect(0)
        .says("Lead none: the plant's timer is set to the beginning");
}

#[test]
fn rehearsals_before_take_off_do_not_count_as_rehearsed_ticks() {
    let rig = Rig::new("few-ticks");
    // 200 ms before it, and 9 ticks of 10 ms.
    let settings = rig.settings("[flight]\nslowdown = 10\nduration_s = 0.008\n");
    rig.run("fly", &["--rt", "off", "--config", &settings, "--lead", "4000"]);
    let report = rig.report();
    let (ticks, rehearsals) =
        (report["ticks"]["run"].as_u64().unwrap(), report["lead"]["rehearsals"].as_u64().unwrap());
    assert!(ticks <= 9 && rehearsals < ticks, "{rehearsals} rehearsals in {ticks} ticks");
    assert!(report["lead"]["rehearsal_us"].as_f64().unwrap() > 0.0, "and there were some: {report}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_with_an_inner_loop_that_dies_and_comes_back_is_identical() {
    let rig = Rig::new("reborn");
    let settings = rig.settings(&TROUBLED.replace("0.8", "0.6").replace("790", "590"));
    let args = ["--rt", "off", "--config", settings.as_str()];
    let start = |role: &str| rig.start(role, &args);
    let (recorder, plant) = (start("record"), start("plant"));
    let (outer, inner, mixer) = (start("outer"), start("inner"), start("mixer"));
    rig.await_flight();
    sleep(Duration::from_millis(500));
    inner.signal(Signal::KILL);
    inner.end();
    let again = start("inner");
    let instance = rig.known();
    wait_until("another inner loop", || (instance.pid_of(Role::Inner) == Some(again.pid())).then_some(()));
    for role in [plant, outer, again, mixer, recorder] {
        role.end();
    }
    verifies(&rig);
    rig.run("replay", &[]).expect(0).says("started 1 time in flight");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_a_signal_ends_is_identical() {
    let rig = Rig::new("signalled");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(10), "--duration", "1h"]);
    sleep(Duration::from_millis(700));
    flight.signal(Signal::INT);
    flight.end().expect(130);
    verifies(&rig);
}

#[test]
fn a_flight_in_lockstep_is_identical() {
    let rig = Rig::new("in-step");
    let options = ["--pace", "lockstep", "--duration", "2s", "--preset", "paper", "--fault", "mass_kg=0.6@1s"];
    rig.run("fly", &options).expect(0);
    verifies(&rig);
}

/// A flight that calls every function of `model::math`, and the hash over its outputs, the same on every machine: it
/// changes with the laws, and with nothing else.
const EVERY_FUNCTION: [&str; 8] = [
    "--trajectory",
    "fast",
    "--duration",
    "2s",
    "--fault",
    "motor_time_constant_s=0.02,gyro_noise_rad_s=0.01,command_delay_s=0.002@200ms",
    "--fault",
    "rotational_drag_nm_s=0.525@1s",
];

#[test]
fn a_flight_its_simulation_and_its_replay_put_out_the_same_bits() {
    let rig = Rig::new("bits");
    let simulated = rig.run("simulate", &EVERY_FUNCTION).expect(0).result();
    let outputs = &simulated["outputs"];
    assert_eq!(outputs.len(), 16, "{simulated:?}");
    rig.run("fly", &[&["--pace", "lockstep"], &EVERY_FUNCTION[..]].concat()).expect(0);
    let replayed = rig.run("replay", &["--verify"]).expect(0);
    assert!(replayed.stdout.ends_with(&format!("identical; outputs {outputs}\n")), "{replayed}, simulated: {outputs}");
    rig.run("replay", &[]).expect(0).says(&format!("outputs    {outputs}\n"));
    let other = rig.run("simulate", &[&EVERY_FUNCTION[..], &["--fault", "mass_kg=0.5200001@1s"]].concat()).result();
    assert_ne!(&other["outputs"], outputs);
}
