//! Ramps in real flights: the same bits in processes, in one process and in replay; what is said of them.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, read_log};
use flight_log::entry::LogEntry;
use rustix::process::Signal;

#[test]
fn a_flight_with_ramps_is_the_same_in_processes_in_one_and_in_replay() {
    let rig = Rig::new("ramped");
    // The second ramp is replaced halfway, and the third outlasts the flight.
    let faults = [
        "mass_kg=0.55~500ms@300ms",
        "rotational_drag_nm_s=0.3~800ms@tick200",
        "rotational_drag_nm_s=0.15@tick600",
        "rotor_efficiency_2=-3%~1m@tick900",
    ];
    let mut options = vec!["--duration", "1500ms"];
    faults.iter().for_each(|fault| options.extend(["--fault", fault]));
    let (flown, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
    rig.run("fly", &[&["--pace", "lockstep", "--every", "1", "--states", &flown], &options[..]].concat()).expect(0);
    rig.run("simulate", &[&["--every", "1", "--states", &simulated], &options[..]].concat()).expect(0);
    assert!(fs::read(&flown).unwrap() == fs::read(&simulated).unwrap(), "the flight in processes is another one");
    rig.run("replay", &["--verify"]).expect(0).says("identical");
    rig.run("replay", &[]).expect(0).says("swap 2 at tick 300: mass_kg 0.52 -> 0.55 over 0.5 s from tick 300\n");

    let (entries, _) = read_log(&rig.out().join("latest/flight.mcap"));
    let logged = entries.iter().filter(|entry| matches!(entry, LogEntry::Swap(_))).count();
    assert_eq!(logged, 4, "a record for each, whatever its length");
    let report = rig.report();
    let of = |swap: usize, key: &str| report["swaps"][swap]["changes"][0][key].as_f64().unwrap();
    assert_eq!((of(0, "old"), of(0, "new"), of(0, "over_s")), (0.105, 0.3, 0.8));
    let halfway = 0.105 + (0.3 - 0.105) * 400.0 / 800.0;
    assert_eq!((of(2, "old"), of(2, "new"), of(2, "over_s")), (halfway, 0.15, 0.0), "what held before it");
    assert_eq!(report["theorem"]["live_swaps"].as_u64(), Some(3), "the ramp of k_r, that of m within it, and the end");
    rig.run("report", &["--full"])
        .expect(0)
        .says("  swap 1 at tick 200 (0.200 s): rotational_drag_nm_s 0.105 -> 0.3 over 0.8 s from tick 200\n")
        .says("  swap 4 at tick 900 (0.900 s): rotor_efficiency_2 1 -> 0.97 over 60 s from tick 900\n");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(page.contains("mass_kg 0.52 -&gt; 0.55 over 0.5 s from tick 300"), "the page's plots");
    assert!(page.contains(">0.5 s</td>") && page.contains(">at once</td>"), "the page's table");
}

#[test]
fn a_ramp_that_is_injected_goes_on_in_the_parameters_in_force() {
    let rig = Rig::new("injected");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(5), "--duration", "1h"]);
    rig.run("inject", &["mass_kg=+5%~20m", "rotor_efficiency_1=0.99"])
        .expect(0)
        .says("parameter epoch 1\n")
        .says("  mass_kg  0.52 -> 0.546 kg over 1200 s\n")
        .says("  rotor_efficiency_1  1.0 -> 0.99\n");
    let mass_kg = || rig.run("params", &["--json"]).json()[0]["in_force"].as_f64().unwrap();
    let (first, then) = (mass_kg(), mass_kg());
    assert!(0.52 < first && first < then && then < 0.546, "{first}, then {then}");
    rig.run("inject", &["mass_kg=nominal"]).expect(0).says(" -> 0.52 kg\n");
    assert_eq!(mass_kg(), 0.52, "the rest of the ramp is replaced");
    flight.signal(Signal::INT);
    flight.end().expect(130);
}

#[test]
fn a_ramp_of_no_length_is_refused_in_the_same_words_everywhere() {
    let rig = Rig::new("rampless");
    for (ramp, told) in [
        ("mass_kg=0.55~0s", "mass_kg: a ramp of `0s`: it is no time; without ~ the change is at once; write the time"),
        ("mass_kg=0.55~-2s", "mass_kg: a ramp of `-2s`: a time is not negative; write the time that it takes, as in"),
        ("mass_kg=+3%~nan", "mass_kg: a ramp of `nan`: "),
        ("mass_kg=0.55~2", "mass_kg: a ramp of `2`: "),
        ("mass_kg=nominal~1000d", "mass_kg: a ramp of `1000d`: it is longer than the longest flight, 30 days"),
        ("mass_kg=9~2s", "mass_kg = 9 is out of range: allowed are 0.05 to 5.0 kg"),
    ] {
        let injected = rig.run("inject", &[ramp]);
        // A value that some airframe could have waits for one that flies.
        if ramp == "mass_kg=9~2s" {
            injected.expect(1)
        } else {
            injected.expect(2).complains(told)
        };
        let fault = format!("{ramp}@1s");
        for command in ["fly", "simulate"] {
            rig.run(command, &["--fault", &fault]).expect(2).complains(told);
        }
        let settings = rig.settings(&format!("[flight]\nfaults = [\"{fault}\"]\n"));
        rig.run("simulate", &["--config", &settings]).expect(2).complains(told);
    }
    rig.assert_nothing_started();
}
