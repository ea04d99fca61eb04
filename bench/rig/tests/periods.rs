//! Flights at other rates than 1 kHz: the same five processes, and the simulated flight bit for bit.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::Rig;

/// Settings of a flight of 250 Hz, whose gains its longer delay allows, and of one of 4 kHz.
const RATES: [(&str, &str); 2] = [
    (
        "250 Hz",
        "[flight]\nperiod_s = 0.004\nduration_s = 2.0\n[inner]\nalpha_1_s = 50.0\nattitude_1_s = [3.0, 3.0, 1.0]\n",
    ),
    ("4 kHz", "[flight]\nperiod_s = 0.00025\nduration_s = 0.5\n"),
];

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_at_another_rate_is_the_simulated_one() {
    for (rate, settings) in RATES {
        let rig = Rig::new("rates");
        let config = rig.settings(settings);
        let (flown, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
        let args = ["--config", config.as_str(), "--every", "1", "--states"];
        rig.run("fly", &[&["--pace", "lockstep"], &args[..], &[flown.as_str()]].concat()).expect(0);
        rig.run("simulate", &[&args[..], &[simulated.as_str()]].concat()).expect(0);
        let (flown, simulated) = (fs::read(flown).unwrap(), fs::read(simulated).unwrap());
        assert!(simulated.len() > 10_000 && flown == simulated, "{rate}: another flight");
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_on_the_clock_at_another_rate_passes() {
    for (rate, settings) in RATES {
        let rig = Rig::new("clock");
        // In slow motion: a tick takes 20 ms, and the laws keep their T.
        let slowdown = if rate == "4 kHz" { 80 } else { 5 };
        let duration = if rate == "4 kHz" { "40ms" } else { "640ms" };
        let slow = settings.replace("[flight]\n", &format!("[flight]\nslowdown = {slowdown}\n"));
        let config = rig.settings(&slow);
        let ended = rig.run("fly", &["--rt", "off", "--config", &config, "--duration", duration]).expect(0);
        assert_eq!(ended.result()["status"], "PASS", "{rate}");
        let report = rig.report();
        let ticks = |key: &str| report["ticks"][key].as_u64().unwrap();
        assert_eq!(ticks("run") + ticks("skipped"), 161, "{rate}");
        assert_eq!(report["run"]["ending"], "completed", "{rate}");
        rig.assert_nothing_left();
    }
}
