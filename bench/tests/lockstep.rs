//! Lockstep: the same four processes, as fast as the chain itself can.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod rig;

use std::fs;

use rig::{Rig, wait_until};
use rustix::process::{Pid, Signal, kill_process};

#[test]
fn a_flight_in_lockstep_is_the_simulated_one_for_every_trajectory_and_preset() {
    for (trajectory, preset) in
        [("hover", "flight"), ("step", "flight"), ("helix", "soft"), ("lissajous", "paper"), ("fast", "flight")]
    {
        let rig = Rig::new("lockstep");
        let faults = ["--fault", "rotational_drag_nm_s=0.525@1s", "--fault", "gyro_noise_rad_s=0.001@tick1500"];
        let options = [&["--trajectory", trajectory, "--preset", preset, "--duration", "3s"], &faults[..]].concat();
        let (flown, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
        let own = ["--pace", "lockstep", "--every", "1", "--states", &flown];
        let ended = rig.run("fly", &[&own, &options[..]].concat()).expect(0);
        rig.run("simulate", &[&["--every", "1", "--states", &simulated], &options[..]].concat()).expect(0);
        assert!(ended.stdout.contains("latencies are not real-time latencies"), "{}", ended.stdout);
        let report = rig.report();
        assert_eq!(report["ticks"]["run"], 3001);
        assert_eq!(report["deadlines"]["missed"], 0);
        assert_eq!(report["recorder"]["lost"]["state"], 0);
        let (flown, simulated) = (fs::read(flown).unwrap(), fs::read(simulated).unwrap());
        assert_eq!(simulated.iter().filter(|byte| **byte == b'\n').count(), 3002, "a header, and a row per tick");
        assert!(flown == simulated, "{trajectory} with {preset} is another flight");
        rig.assert_nothing_left();
    }
}

#[test]
fn a_stage_that_stops_in_lockstep_ends_the_flight_with_its_name() {
    let rig = Rig::new("stopped");
    let flight = rig.take_off(&["--pace", "lockstep", "--duration", "10h"]);
    let pid = fs::read_to_string(rig.root().join(&rig.instance).join("inner.lock")).unwrap();
    let inner = Pid::from_raw(pid.trim().parse().unwrap()).unwrap();
    kill_process(inner, Signal::STOP).unwrap();
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
