//! What is said of a flight is of that flight: no timer in lockstep, no tick that no law worked, no error of a sensor.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::Rig;

const LOCKSTEP: [&str; 4] = ["--pace", "lockstep", "--duration", "100ms"];

#[test]
fn flags_of_the_clock_are_refused_in_lockstep() {
    let rig = Rig::new("clockless");
    for flag in [
        &["--lead", "250"][..],
        &["--lead", "auto"],
        &["--cpu", "0"],
        &["--rehearse", "false"],
        &["--rt", "require"],
        &["--trace"],
    ] {
        let [name, ..] = flag else { unreachable!() };
        let told = format!("{name} has no meaning in lockstep, where no clock moves the ticks");
        let remedy = format!("help: leave {name} out, or fly on the clock: --pace realtime");
        for command in ["fly", "record", "plant"] {
            if command == "plant" && *name == "--trace" {
                continue;
            }
            let refused = rig.run(command, &[flag, &["--pace", "lockstep"]].concat()).expect(2);
            refused.complains(&told).complains(&remedy);
        }
        let config = rig.settings("[flight]\npace = \"lockstep\"\n");
        rig.run("fly", &[flag, &["--config", &config]].concat()).expect(2).complains(&told);
    }
    rig.assert_nothing_started();
    // What lockstep does anyway, and what a settings file has for flights on the clock.
    let config = rig.settings("[rt]\nlead_us = 250\nmode = \"prefer\"\n");
    rig.run("fly", &[&LOCKSTEP[..], &["--rt", "off", "--config", &config]].concat()).expect(0);
}

#[test]
fn a_flight_in_lockstep_has_no_timer_and_its_mixer_no_tick_after_the_last() {
    let rig = Rig::new("timerless");
    rig.run("fly", &LOCKSTEP).expect(0);
    let full = rig.run("report", &["--full"]).expect(0);
    assert!(!full.stdout.contains("Lead "), "{full}");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(!page.contains("Lead none"), "the page");
    let replayed = rig.run("replay", &[]).expect(0);
    replayed.says("inner loop fresh 101, ").says("mixer      fresh 101, held 0, fallback 0, idle 0, ");
    rig.run("fly", &["--rt", "off", "--config", &rig.slow(5), "--duration", "50ms"]);
    rig.run("report", &["--full"]).says("Lead none: the plant's timer is set to the beginning of the tick");
}

#[test]
fn a_schema_that_was_changed_is_damage_and_not_another_version() {
    let rig = Rig::new("flipped-schema");
    rig.run("fly", &LOCKSTEP).expect(0);
    let log = rig.out().join("latest/flight.mcap");
    let mut bytes = fs::read(&log).unwrap();
    // A name of a field in the schema of the topic `state`, before the first chunk.
    let name = b"deadline_miss_run";
    let at = bytes.windows(name.len()).position(|window| window == name).unwrap();
    bytes[at] ^= 1;
    fs::write(&log, bytes).unwrap();
    let refused = rig.run("replay", &[]).expect(1).complains("flight.mcap is damaged or no flight log: ");
    assert!(!refused.stderr.contains("another version"), "{refused}");
}

#[test]
fn a_flight_is_judged_by_where_it_is_and_not_by_what_its_sensors_show() {
    let rig = Rig::new("judged");
    // Fixes that are off by metres. In 0.2 s, no airframe follows them far.
    let noisy = rig.settings(
        "[flight]\ntrajectory = \"hover\"\nduration_s = 0.2\nposition_error_max_m = 1.0\n\
         [plant]\nposition_noise_m = 8.0\n",
    );
    let simulated = rig.run("simulate", &["--config", &noisy]).expect(0);
    let error_m = |told: &str| -> f64 {
        let (_, rest) = told.split_once("largest ").unwrap();
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    assert!(error_m(&simulated.stdout) < 1.0, "fixes are off by 8 m, the flight is not: {simulated}");
    rig.run("fly", &["--pace", "lockstep", "--config", &noisy]).expect(0);
    let outputs = &simulated.result()["outputs"];
    rig.run("replay", &["--verify"]).expect(0).says(&format!("identical; outputs {outputs}\n"));
    let performance = rig.report()["flight"].clone();
    assert!(performance["position_error_max_m"].as_f64().unwrap() < 1.0, "{performance}");
    assert!(performance["lowest_z_m"].as_f64().unwrap() > -1.0, "{performance}");
    let (columns, rows) = states(&rig);
    let z = columns.iter().position(|name| name.starts_with('z')).unwrap();
    assert!(rows.iter().any(|row| row[z].abs() > 2.0), "states.csv has what is shown");
}

/// The columns of states.csv, and its rows.
fn states(rig: &Rig) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = fs::read_to_string(rig.out().join("latest/states.csv")).unwrap();
    let mut lines = text.lines();
    let columns = lines.next().unwrap().split(',').map(str::to_owned).collect();
    (columns, lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect())
}

#[test]
fn one_is_not_many() {
    let rig = Rig::new("one");
    let one = rig.run("simulate", &["--duration", "1ms", "--fault", "mass_kg=0.55@tick0"]).expect(0);
    one.says(": 2 ticks, ");
    let file = rig.file("short.csv");
    fs::write(&file, "t,x,y,z,yaw\n0\n").unwrap();
    rig.run("simulate", &["--trajectory", &file]).expect(2).complains("line 2 has 1 column: expected 5");
}
