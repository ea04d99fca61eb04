//! Wrong settings whose cause is easily mistaken: the error names the key, the file or the flag that it is in.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;

use crate::rig::Rig;
use rustix::process::Signal;

/// What `simulate` with a settings file is told, and whether it is told of the file.
fn told(rig: &Rig, text: &str, flags: &[&str], words: &str, of_file: bool) {
    let config = rig.settings(text);
    let refused = rig.run("simulate", &[&["--config", &config], flags].concat()).expect(2).complains(words);
    let named = refused.stderr.contains("settings file");
    assert_eq!(named, of_file, "{text} {flags:?}: {refused}");
}

#[test]
fn the_key_that_is_wrong_is_named_and_not_the_one_it_is_compared_with() {
    let rig = Rig::new("wrong-keys");
    for (text, words) in [
        ("[flight]\nperiod_s = nan\n", "flight.period_s = NaN is out of range: allowed is 0.0001 to 0.02 s"),
        ("[flight]\nperiod_s = 1e300\n", "flight.period_s = 1e300 is out of range: allowed is 0.0001 to 0.02 s"),
        ("[flight]\nduration_s = 1e300\n", "flight.duration_s = 1e300 is out of range: allowed are 0.001 to 2592000"),
        (
            "[flight]\nseed = -1\n",
            "flight.seed = -1 is out of range: allowed are whole numbers from 0 to 922337203685477",
        ),
        (
            "[recorder]\nlog_files = -2\n",
            "recorder.log_files = -2 is out of range: allowed are whole numbers from 0 to",
        ),
        (
            "[flight]\nairframe = \"paper\"\nseed = 99999999999999999999999\n",
            "line 3: a whole number beyond 9223372036854775807 cannot be read",
        ),
        ("[model]\ngravity_m_s2 = 0\n", "model.gravity_m_s2 = 0: the laws hold a weight, and have none then"),
        ("[model]\ngravity_m_s2 = 0\n[rotor]\nmin_rad_s = 0\n", "write a gravity above 0, and for an airframe without"),
        ("[plant]\nmass_kg = 1e300\n", "plant.mass_kg = 1e300 is out of range: allowed are 0.05 to 5.0 kg"),
    ] {
        told(&rig, text, &[], words, true);
    }
    // Flights without weight, and of rotors without drag torque, are none of the errors.
    for text in ["[plant]\ngravity_m_s2 = 0\n", "[airframe]\ndrag_factor_nm_s2 = 0\n"] {
        let config = rig.settings(text);
        let flown = rig.run("simulate", &["--config", &config, "--duration", "100ms"]).expect(0);
        assert!(!flown.stderr.contains("warning"), "{text}: {flown}");
    }
    rig.assert_nothing_started();
}

#[test]
fn a_settings_file_is_named_for_what_is_in_it_and_not_for_what_a_flag_says() {
    let rig = Rig::new("wrong-flags");
    let innocent = "[flight]\nseed = 3\n";
    for (flags, words) in [
        (["--duration", "0s"], "flight.duration_s = 0 is out of range"),
        (["--fault", "mass_kg=9@1s"], "mass_kg = 9 is out of range"),
        (["--trajectory", "/nowhere/a.csv"], "cannot read the trajectory file /nowhere/a.csv"),
    ] {
        told(&rig, innocent, &flags, words, false);
    }
    // The file has a part in these.
    told(
        &rig,
        "[flight]\nduration_s = 1.0\n",
        &["--fault", "mass_kg=0.6@2s"],
        "a fault at tick 2000 never strikes",
        true,
    );
    told(&rig, "[flight]\nduration_s = -1.0\n", &["--fault", "mass_kg=0.6@2s"], "flight.duration_s = -1", true);
    rig.assert_nothing_started();
}

#[test]
fn a_whole_airframe_has_its_own_rotors_and_rotors_from_a_file_are_told_with_its_name() {
    let rig = Rig::new("wrong-rotors");
    let printed = rig.run("fly", &["--airframe", "crazyflie", "--print-config"]).expect(0).stdout.clone();
    let (before, after) = printed.split_once("\n[rotor]").unwrap();
    let without = format!("{before}{}", &after[after.find("\n[").unwrap()..]);
    told(&rig, &without, &[], "a whole section [airframe] has its own rotors", true);
    told(&rig, &without, &[], "help: write them beside it: [rotor] with min_rad_s and max_rad_s", true);
    let own = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/airframes/x500.toml")).unwrap();
    let turned: String = own
        .lines()
        .map(|line| if line.starts_with("min_rad_s") { "min_rad_s = 5000\n".into() } else { format!("{line}\n") })
        .collect();
    let line = 1 + turned.lines().position(|line| line.starts_with("min_rad_s")).unwrap();
    fs::write(rig.file("turned.toml"), turned).unwrap();
    let refused = rig.run("simulate", &["--airframe", &rig.file("turned.toml")]).expect(2);
    refused
        .complains("airframe file ")
        .complains(&format!("turned.toml: line {line}: rotor.min_rad_s = 5000 must not be above rotor.max_rad_s = "));
    rig.assert_nothing_started();
}

#[test]
fn settings_that_do_not_fit_are_refused_before_take_off_with_what_takes_the_room() {
    let rig = Rig::new("wrong-length");
    let fault = |tick| {
        format!(
            "--fault=mass_kg=0.52{tick:020},gravity_m_s2=9.8{tick:020},arm_length_m=0.205{tick:020},inertia_x_kg_m2=0.0069@tick{tick}"
        )
    };
    let faults: Vec<String> = (1..=60).map(fault).collect();
    let flags: Vec<&str> = faults.iter().map(String::as_str).collect();
    for command in ["fly", "simulate"] {
        let refused = rig.run(command, &flags).expect(2).complains("the settings that the processes share are ");
        refused.complains("bytes long: allowed are 8192, and flight.faults takes ").complains("help: put values that");
    }
    rig.assert_nothing_started();
}

#[test]
fn an_injection_names_the_range_of_the_airframe_that_flies_also_for_the_impossible() {
    let rig = Rig::new("impossible");
    let grounded = rig.run("inject", &["mass_kg=-1"]).expect(2);
    grounded
        .complains("mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg for the airframe `paper`, and no other");
    let quoted = rig.file("it's \"so\".csv");
    fs::write(&quoted, "t,x,y,z,yaw\n0,0,0,0,0\n5,0,0,0.1,0\n").unwrap();
    let slow = rig.slow(10);
    let args =
        ["--rt", "off", "--airframe", "crazyflie", "--config", &slow, "--duration", "1h", "--trajectory", &quoted];
    let flight = rig.take_off(&args);
    for (value, said) in [("-1", "-1"), ("1e300", "1e300"), ("600", "600")] {
        let refused = rig.run("inject", &[&format!("mass_kg={value}")]).expect(2);
        refused.complains(&format!("mass_kg = {said} is out of range: allowed are 0.00259"));
    }
    let digits = "1".repeat(300);
    let refused = rig.run("inject", &[&format!("mass_kg={digits}")]).expect(2);
    assert!(refused.stderr.len() < 400, "{refused}");
    // Whoever reads the flight's settings reads the name of its file, whatever is in it.
    let watch = rig.start("watch", &["--plain"]);
    rig::wait_until("a line", || watch.stdout().contains("   error ").then_some(()));
    flight.signal(Signal::INT);
    flight.end().expect(130);
    watch.end().expect(0);
}
