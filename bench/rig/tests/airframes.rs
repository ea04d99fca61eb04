//! Airframes and trajectories of files and built-in ones, in all commands. `refusals/airframes.md` and
//! `refusals/trajectories.md` have the mistakes of files.

use crate::reference_laws;
use crate::rig::{Rig, not_tested};
use controller::laws::adaptive;
use controller::{Gains, Trajectory};
use messages::parameters::{Airframe, Parameter};
use sim::simulator::Simulator;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;

/// A file of the Crazyflie's size, which is a bit heavier.
const OWN: &str = "[airframe]\nmass_kg = 0.03\ngravity_m_s2 = 9.8\ntranslational_drag_kg_s = 8e-3\n\
                   rotational_drag_nm_s = 1.7e-5\narm_length_m = 0.046\nthrust_coefficient_n_s2 = 1.6e-8\n\
                   drag_factor_nm_s2 = 7.6e-11\nrotor_inertia_kg_m2 = 1.1e-7\ninertia_x_kg_m2 = 1.7e-5\n\
                   inertia_y_kg_m2 = 1.7e-5\ninertia_z_kg_m2 = 2.9e-5\n[rotor]\nmin_rad_s = 200\nmax_rad_s = 2618\n";

const CLIMB: &str = "t,x,y,z,yaw\n0,0,0,0,0\n2,0.5,0,0.5,0\n4,1,-0.5,1,0.5\n";

#[test]
fn every_built_in_airframe_flies_every_trajectory() {
    let rig = Rig::new("airframes");
    for airframe in ["paper", "crazyflie", "x500"] {
        for trajectory in Trajectory::NAMES {
            let options = format!("--airframe {airframe} --trajectory {trajectory}");
            let flight = rig.ok(&format!("simulate {options}"));
            let (_, rest) = flight.stdout.split_once("at the end ").unwrap();
            let last_m: f64 = rest.split([' ', ',']).next().unwrap().parse().unwrap();
            assert!(last_m < 0.1, "{options}: {last_m}");
        }
    }
}

#[test]
fn an_airframe_with_more_inertia_flies_alike_under_its_gains() {
    use Parameter::{
        ArmLength, DragFactor, InertiaX, InertiaY, InertiaZ, RotationalDrag, RotorInertia,
    };
    let paper = Airframe::nominal();
    // Its inertia times `scale`, and with it whatever turns it, so that it turns alike under that times the torque.
    let enlarged = |scale: f64| {
        let mut values = *paper.values();
        for parameter in [
            InertiaX,
            InertiaY,
            InertiaZ,
            RotationalDrag,
            RotorInertia,
            ArmLength,
            DragFactor,
        ] {
            values[parameter as usize] *= scale;
        }
        Airframe::built_with(values).unwrap()
    };
    let flight = |airframe: Airframe| {
        let law_rig = control_api::Rig {
            airframe,
            ..control_api::Rig::default()
        };
        let gains = Gains::default().scaled(&paper, &airframe);
        let (outer, inner, mixer) = reference_laws::stages(&law_rig, Trajectory::Fast, &gains);
        let plant = plant::PlantSettings {
            airframe,
            seed: 1,
            ..plant::PlantSettings::default()
        };
        Simulator::new(&plant, outer, inner, mixer)
    };
    for scale in [2.0, 0.25, 3e-3, 40.0] {
        let mut flights = [flight(paper), flight(enlarged(scale))];
        for tick in 0..8000 {
            flights.iter_mut().for_each(Simulator::tick);
            let [one, other] = [0, 1].map(|i| flights[i].state().measured.position_w_m);
            let is_close = one.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(is_close, "{scale} times the inertia, tick {tick}");
            let [one, other] = [0, 1].map(|i| adaptive::estimate(&flights[i].wrench().telemetry));
            assert!(
                (one[1] - other[1] / scale).abs() < 1e-5,
                "{one:?} {other:?}"
            );
            assert!((one[2] - other[2]).abs() < 1e-4, "{one:?} {other:?}");
        }
        assert!(adaptive::estimate(&flights[0].wrench().telemetry)[1] > 0.01);
    }
}

#[test]
fn files_fly_in_processes_as_in_simulation_and_are_replayed_without_the_files() {
    let rig = Rig::new("own-files");
    let (file, climb, states) = (
        rig.file("own.toml"),
        rig.file("climb.csv"),
        rig.file("s.csv"),
    );
    fs::write(&file, OWN).unwrap();
    fs::write(&climb, CLIMB).unwrap();
    // A flight ends where its points end.
    rig.ok(&format!(
        "simulate --trajectory {climb} --duration 20s --states {states}"
    ));
    let text = fs::read_to_string(&states).unwrap();
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let last: Vec<&str> = lines.next_back().unwrap().split(',').collect();
    for (name, expected) in [("x", 1.0), ("y", -0.5), ("z", 1.0)] {
        let column = header.iter().position(|it| *it == name).unwrap();
        let value: f64 = last[column].parse().unwrap();
        assert!((value - expected).abs() < 0.01, "{name} = {value}");
    }
    let sums = std::process::Command::new("sha256sum").arg(&file).output();
    let sum = String::from_utf8(sums.unwrap().stdout).unwrap()[..64].to_owned();
    let named = format!("airframe own.toml (sha256 {})", &sum[..12]);
    let options = format!(
        "--airframe {file} --trajectory {climb} --duration 500ms --fault mass_kg=+10%@100ms"
    );
    rig.ok(&format!("fly {options} --pace lockstep"))
        .says("trajectory climb.csv, gains flight");
    let simulated = rig.ok(&format!("simulate {options}"));
    let simulated = simulated.says(&format!("{named}: 501 ticks")).result();
    let report = rig.report();
    assert_eq!(report["swaps"][0]["changes"][0]["new"], 0.03 * 1.1);
    assert_eq!(report["run"]["airframe_sha256"], sum.as_str());
    rig.ok("report --full").says(&named);
    for file in ["report.html", "flight.svg"] {
        assert!(rig.flown(file).contains(&named), "{file} names it");
    }
    rig.ok("runs")
        .says(", own.toml\n")
        .says("; an airframe is named where it is not `paper`\n");
    assert_eq!(rig.ok("runs --json").json()[0]["airframe"], "own.toml");
    // The settings of the flight, whole as they are, need no airframe file.
    fs::remove_file(&file).unwrap();
    let left = rig.out().join("latest/settings.toml");
    rig.ok(&format!(
        "simulate --config {} --trajectory hover",
        left.display()
    ))
    .says(&named);
    fs::remove_file(&climb).unwrap();
    rig.ok("replay").says(&named);
    rig.ok("replay latest --verify")
        .says(&format!("identical; outputs {}\n", simulated["outputs"]));
}

#[test]
fn ranges_and_injections_follow_the_airframe() {
    let rig = Rig::new("ranges");
    let rows = rig.ok("params --airframe crazyflie --json").json();
    let mut rows = rows.as_array().unwrap().iter();
    let mass = rows.find(|row| row["name"] == "mass_kg").unwrap();
    assert_eq!(mass["nominal"], 0.027);
    assert!((mass["max"].as_f64().unwrap() - 5.0 * 0.027 / 0.52).abs() < 1e-12);

    let slow = rig.slow(20);
    let flight = rig.take_off(format!(
        "--rt off --airframe x500 --config {slow} --duration 1h"
    ));
    let nominal_kg = 2.064_307_692_3;
    let more = format!("  mass_kg  {nominal_kg:?} -> {:?} kg\n", nominal_kg * 1.1);
    rig.ok("inject mass_kg=+10%").says(&more);
    rig.ok("inject mass_kg=nominal")
        .says(&format!(" -> {nominal_kg:?} kg\n"));
    rig.refused("inject mass_kg=0.1")
        .complains("mass_kg = 0.1 is out of range: allowed are 0.198");
    assert_eq!(rig.ok("params --json").json()[0]["nominal"], nominal_kg);
    flight.interrupt().expect(130);
}

#[test]
fn printed_settings_are_the_same_flight_and_not_mixed_with_another_airframe() {
    let rig = Rig::new("mixed-airframe");
    let file = rig.file("own.toml");
    fs::write(&file, OWN).unwrap();
    let print = |airframe: &str| {
        let printed = rig.ok(&format!("fly --airframe {airframe} --print-config"));
        rig.settings(&printed.stdout)
    };
    for (printed_for, flag) in [
        ("paper", "crazyflie"),
        ("x500", "paper"),
        (&*file, "x500"),
        ("x500", &file),
    ] {
        let config = print(printed_for);
        for command in ["fly", "simulate", "plant"] {
            rig.refused(&format!("{command} --config {config} --airframe {flag}"))
                .complains("its whole sections [plant], [model], [rotor], [outer], [inner], [mixer] are of the airframe ")
                .complains(&format!("`{printed_for}`, and would go before those of --airframe {flag}"))
                .complains(&format!("ironbird fly --airframe {flag} --print-config"));
        }
        let outputs = |options: String| {
            let flown = rig.ok(&format!("simulate --duration 100ms {options}"));
            flown.result()["outputs"].clone()
        };
        let chosen = outputs(format!("--airframe {printed_for}"));
        assert_eq!(outputs(format!("--config {config}")), chosen);
        let both = format!("--config {config} --airframe {printed_for}");
        assert_eq!(outputs(both), chosen);
    }
    // Single settings are meant for any airframe.
    let few = rig.settings("[model]\nmass_kg = 0.03\n[rotor]\nmin_rad_s = 0\nmax_rad_s = 2700\n");
    rig.ok(&format!(
        "simulate --config {few} --airframe crazyflie --duration 100ms"
    ));
    rig.assert_nothing_started();
}

#[test]
fn a_changed_file_is_refused_by_both_hashes() {
    let rig = Rig::new("changed-files");
    for (flag, name, text, changed, key) in [
        (
            "--airframe",
            "own.toml",
            OWN,
            OWN.replace("0.03", "0.031"),
            "\nairframe_sha256 = \"",
        ),
        (
            "--trajectory",
            "climb.csv",
            CLIMB,
            CLIMB.replace("0,0.5,0", "0,0.6,0"),
            "\nsha256 = \"",
        ),
    ] {
        let (file, other) = (rig.file(name), rig.file(&format!("other-{name}")));
        fs::write(&file, text).unwrap();
        fs::write(&other, &changed).unwrap();
        let print = |options: &str| rig.ok(&format!("fly {options} --print-config")).stdout;
        let hash = |printed: &str| -> String {
            let (_, rest) = printed.split_once(key).unwrap();
            rest.split('"').next().unwrap().into()
        };
        let printed = print(&format!("{flag} {file}"));
        let (config, sum) = (rig.settings(&printed), hash(&printed));
        assert_eq!(sum.len(), 64);
        rig.ok(&format!("simulate --config {config} --duration 100ms"));
        fs::write(&file, &changed).unwrap();
        for line in ["simulate", "outer", "record"] {
            rig.refused(&format!("{line} --config {config} {flag} {file}"))
                .complains("but the settings were made for ")
                .complains(&sum);
        }
    }
    rig.assert_nothing_started();
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let rig = Rig::new("bad-files");
    fs::write(rig.file("binary.toml"), [0xff, 0xfe, 0x00]).unwrap();
    let binary = b"t,x,y,z,yaw\n0,0,0,0,0\n\xff,0,0,0,0\n";
    fs::write(rig.file("binary.csv"), binary).unwrap();
    fs::write(rig.file("long.csv"), vec![b'0'; (4 << 20) + 1]).unwrap();
    fs::create_dir(rig.file("folder.toml")).unwrap();
    fs::create_dir(rig.file("folder.csv")).unwrap();
    let locked = rig.file("locked.toml");
    fs::write(&locked, OWN).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o000)).unwrap();
    for (flag, file, why) in [
        (
            "--airframe",
            "binary.toml",
            "stream did not contain valid UTF-8",
        ),
        ("--airframe", "folder.toml", "it is not a regular file"),
        ("--airframe", "locked.toml", "Permission denied"),
        ("--trajectory", "long.csv", "it is longer than 4 MiB"),
        ("--trajectory", "folder.csv", "it is not a regular file"),
        ("--trajectory", "binary.csv", "line 3 is not UTF-8"),
    ] {
        if file == "locked.toml" && fs::read(&locked).is_ok() {
            not_tested("a file that may not be read: this user may read every file");
            continue;
        }
        for command in ["fly", "simulate", "outer"] {
            let refused = rig.refused(&format!("{command} {flag} {}", rig.file(file)));
            refused.complains(&format!("{file}: {why}"));
        }
    }
    rig.assert_nothing_started();
}
