//! Lockstep: the same four processes, as fast as the chain itself can.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, send, wait_until};
use controller::Trajectory;
use controller::gains::PRESET_NAMES;
use model::parameters::{SPECS, Spec};
use rustix::process::Signal;

/// A swap of a parameter to a value that a flight survives.
fn swap_of(spec: &Spec, instant: &str) -> String {
    let other = match spec.nominal {
        0.0 => 1e-3,
        nominal => nominal * 0.97,
    };
    format!("{}={other}@{instant}", spec.name)
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_is_the_simulated_one_for_every_trajectory_preset_and_parameter() {
    let mut parameters = SPECS.iter().cycle();
    for trajectory in Trajectory::ALL {
        for preset in PRESET_NAMES {
            let rig = Rig::new("lockstep");
            let faults: Vec<String> =
                ["tick1", "333ms", "tick777", "tick777"].map(|at| swap_of(parameters.next().unwrap(), at)).into();
            let mut options = vec!["--trajectory", trajectory.name(), "--preset", preset, "--duration", "1500ms"];
            faults.iter().for_each(|fault| options.extend(["--fault", fault]));
            let (flown, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
            let own = ["--pace", "lockstep", "--every", "1", "--states", &flown];
            let ended = rig.run("fly", &[&own, &options[..]].concat()).expect(0);
            rig.run("simulate", &[&["--every", "1", "--states", &simulated], &options[..]].concat()).expect(0);
            ended.tells("latencies are not real-time latencies");
            let report = rig.report();
            assert_eq!((&report["ticks"]["run"], &report["deadlines"]["missed"]), (&1501.into(), &0.into()));
            assert_eq!(
                (&report["recorder"]["lost"]["state"], report["swaps"].as_array().unwrap().len()),
                (&0.into(), 4)
            );
            let (flown, simulated) = (fs::read(flown).unwrap(), fs::read(simulated).unwrap());
            assert_eq!(simulated.iter().filter(|byte| **byte == b'\n').count(), 1502, "a header, and a row per tick");
            assert!(flown == simulated, "{trajectory} with {preset} and {faults:?} is another flight");
            rig.assert_nothing_left();
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_stage_that_stops_in_lockstep_ends_the_flight_with_its_name() {
    let rig = Rig::new("stopped");
    let flight = rig.take_off(&["--pace", "lockstep", "--duration", "10h"]);
    send(flight.roles()["inner"], Signal::STOP);
    let ended = flight.end();
    assert_eq!(ended.code, Some(1), "{}{}", ended.stdout, ended.stderr);
    assert!(ended.stderr.contains("in lockstep: a stage hangs or has died"), "{}", ended.stderr);
    wait_until("nothing to be left", || rig.segments().is_empty().then_some(()));
}

#[test]
fn swaps_are_injected_in_lockstep_and_signals_end_it() {
    let rig = Rig::new("swapped");
    let flight = rig.take_off(&["--pace", "lockstep", "--duration", "10h"]);
    let answer = rig.run("inject", &["mass_kg=0.6"]).expect(0);
    assert!(answer.stdout.contains("mass_kg  0.52 -> 0.6 kg"), "{}", answer.stdout);
    flight.signal(Signal::INT);
    let ended = flight.end();
    assert_eq!(ended.code, Some(130), "{}{}", ended.stdout, ended.stderr);
    assert_eq!(rig.report()["swaps"][0]["changes"][0]["new"], 0.6);
    rig.assert_nothing_left();
}
