//! Whole flights: in processes and in lockstep.

use crate::rig::{Rig, assert_same_rows};
use controller::Trajectory;
use controller::gains::PRESET_NAMES;
use messages::parameters::SPECS;
use std::fs;
use std::io::Write as _;

/// Flies in ever slower motion until no stage was late for any tick, because only then nothing depends on the machine.
fn without_a_miss(rig: &Rig, fly: impl Fn(u64)) {
    let mut late = Vec::new();
    for slowdown in [20, 60, 60, 150, 150] {
        fly(slowdown);
        let report = rig.final_report();
        let stages = ["outer", "inner", "mixer"].map(|role| &report.roles[role]);
        let stale = stages.map(|role| role.ticks_stale + role.ticks_skipped);
        let found = (report.deadlines.missed, report.ticks.skipped, stale);
        if found == (0, 0, [0; 3]) {
            if !late.is_empty() {
                // Past the harness, which shows what a test prints when it fails alone.
                let _ = writeln!(
                    std::io::stderr().lock(),
                    "TRIES {}: {late:?}",
                    late.len() + 1
                );
            }
            return;
        }
        late.push((slowdown, found));
    }
    panic!("slowdown, missed, skipped and stale ticks: {late:?}");
}

#[test]
fn a_flight_without_misses_is_the_simulated_one_byte_for_byte() {
    let rig = Rig::new("same");
    let (states, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
    let options = "--duration 150ms --every 1 --preset paper --trajectory fast \
                   --fault gyro_noise_rad_s=0.02@tick7 --fault rotational_drag_nm_s=0.525,mass_kg=0.6@60ms";
    without_a_miss(&rig, |slowdown| {
        let slow = rig.slow(slowdown);
        rig.ok(&format!(
            "fly --rt prefer --config {slow} --states {states} {options}"
        ));
    });
    rig.ok(&format!("simulate {options} --states {simulated}"));
    let flown = fs::read(&states).unwrap();
    assert_same_rows(&flown, &fs::read(&simulated).unwrap(), 151);
    assert_eq!(rig.flown("states.csv").as_bytes(), flown, "both copies");
    let report = rig.report();
    assert_eq!(report["verdict"]["status"], "COMPLETED");
    assert_eq!(report["recorder"]["incomplete_ticks"], 0);
    assert_eq!(report["deadlines"]["missed_by_stamps"], 0);
    assert_eq!(report["ticks"]["run"], 151);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_is_the_simulated_one_for_every_trajectory_preset_and_parameter() {
    let mut parameters = SPECS.iter().cycle();
    for trajectory in Trajectory::ALL {
        for preset in PRESET_NAMES {
            let rig = Rig::new("lockstep");
            // Values that a flight survives.
            let faults = ["tick1", "333ms", "tick777", "tick777"].map(|at| {
                let spec = parameters.next().unwrap();
                let is_zero = spec.nominal == 0.0;
                let value = if is_zero { 1e-3 } else { spec.nominal * 0.97 };
                format!(" --fault {}={value}@{at}", spec.name)
            });
            let faults = faults.concat();
            let options =
                format!("--trajectory {trajectory} --preset {preset} --duration 1500ms{faults}");
            let flight = rig.flies_as_simulated(&options, 1501);
            flight.tells("latencies are not real-time latencies");
            let report = rig.final_report();
            assert_eq!((report.ticks.run, report.deadlines.missed), (1501, 0));
            assert_eq!((report.recorder.lost["state"], report.swaps.len()), (0, 4));
            rig.assert_nothing_left();
        }
    }
}
