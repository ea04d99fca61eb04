//! Airframes to choose from: built in and of a file, in all commands; what is wrong with a file is told at once.

use crate::reference_laws;
use crate::rig::{self, Rig};
use controller::laws::adaptive;
use controller::{Gains, Trajectory};
use ironbird::simulator::Simulator;
use messages::parameters::{Airframe, Parameter};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;

/// A file of the Crazyflie's size, which is a bit heavier.
const OWN: &str = "[airframe]\nmass_kg = 0.03\ngravity_m_s2 = 9.8\ntranslational_drag_kg_s = 8e-3\n\
                   rotational_drag_nm_s = 1.7e-5\narm_length_m = 0.046\nthrust_coefficient_n_s2 = 1.6e-8\n\
                   drag_factor_nm_s2 = 7.6e-11\nrotor_inertia_kg_m2 = 1.1e-7\ninertia_x_kg_m2 = 1.7e-5\n\
                   inertia_y_kg_m2 = 1.7e-5\ninertia_z_kg_m2 = 2.9e-5\n[rotor]\nmin_rad_s = 200\nmax_rad_s = 2618\n";

/// The position error that `simulate` tells, by its name [m].
fn error_m(told: &str, name: &str) -> f64 {
    let line = told
        .lines()
        .find(|line| line.starts_with("position error "))
        .unwrap();
    let value = line.split_once(&format!("{name} ")).unwrap().1;
    value.split([' ', ',']).next().unwrap().parse().unwrap()
}

#[test]
fn every_built_in_airframe_flies_every_trajectory() {
    let rig = Rig::new("airframes");
    for airframe in ["paper", "crazyflie", "x500"] {
        for trajectory in Trajectory::NAMES {
            let flight = rig.ok(&format!(
                "simulate --airframe {airframe} --trajectory {trajectory}"
            ));
            let last_m = error_m(&flight.stdout, "at the end");
            assert!(last_m < 0.1, "{airframe}, {trajectory}: {last_m}");
        }
    }
}

/// The paper's airframe with `s` times the inertia, and whatever turns it alike under s times the torque.
fn enlarged(s: f64) -> Airframe {
    use Parameter::{
        ArmLength, DragFactor, InertiaX, InertiaY, InertiaZ, RotationalDrag, RotorInertia,
    };
    let mut values = *Airframe::nominal().values();
    for parameter in [
        InertiaX,
        InertiaY,
        InertiaZ,
        RotationalDrag,
        RotorInertia,
        ArmLength,
        DragFactor,
    ] {
        values[parameter as usize] *= s;
    }
    Airframe::built_with(values).unwrap()
}

#[test]
fn an_airframe_with_more_inertia_flies_alike_under_its_gains() {
    let flight = |airframe: Airframe| {
        let law_rig = control_api::Rig {
            airframe,
            ..control_api::Rig::default()
        };
        let gains = Gains::default().scaled(&Airframe::nominal(), &airframe);
        let (outer, inner, mixer) = reference_laws::stages(&law_rig, Trajectory::Fast, &gains);
        let plant = plant::PlantSettings {
            airframe,
            seed: 1,
            ..plant::PlantSettings::default()
        };
        Simulator::new(&plant, outer, inner, mixer)
    };
    for s in [2.0, 0.25, 3e-3, 40.0] {
        let (mut paper, mut other) = (flight(Airframe::nominal()), flight(enlarged(s)));
        for tick in 0..8000 {
            paper.tick();
            other.tick();
            for axis in 0..3 {
                let apart_m = paper.state().measured.position_w_m[axis]
                    - other.state().measured.position_w_m[axis];
                assert!(
                    apart_m.abs() < 1e-6,
                    "{s} times the inertia, tick {tick}: {apart_m} m apart"
                );
            }
            let [one, many] =
                [&paper, &other].map(|flight| adaptive::estimate(&flight.wrench().telemetry));
            assert!(
                (one[1] - many[1] / s).abs() < 1e-5 && (one[2] - many[2]).abs() < 1e-4,
                "{one:?} {many:?}"
            );
        }
        assert!(
            adaptive::estimate(&paper.wrench().telemetry)[1] > 0.01,
            "it has learnt"
        );
    }
}

#[test]
fn an_airframe_file_flies_in_processes_as_in_simulation_and_is_replayed_without_the_file() {
    let rig = Rig::new("own-airframe");
    let file = rig.file("own.toml");
    fs::write(&file, OWN).unwrap();
    let flight = [
        "--airframe",
        &file,
        "--duration",
        "500ms",
        "--fault",
        "mass_kg=+10%@100ms",
    ];
    rig.run("fly", [&flight[..], &["--pace", "lockstep"]].concat())
        .expect(0);
    let simulated = rig.run("simulate", flight).expect(0).result();
    let change = &rig.report()["swaps"][0]["changes"][0];
    assert_eq!(change["new"].as_f64(), Some(0.03 * 1.1), "{change}");
    let sums = std::process::Command::new("sha256sum")
        .arg(&file)
        .output()
        .unwrap();
    let sum = String::from_utf8(sums.stdout).unwrap()[..64].to_owned();
    let named = format!("airframe own.toml (sha256 {})", &sum[..12]);
    assert_eq!(rig.report()["run"]["airframe_sha256"], sum.as_str());
    rig.ok("report --full").says(&named);
    rig.ok("report").says("airframe own.toml");
    rig.run("simulate", flight)
        .expect(0)
        .says(&format!("{named}: 501 ticks"));
    for file in ["report.html", "flight.svg"] {
        let text = fs::read_to_string(rig.out().join("latest").join(file)).unwrap();
        assert!(text.contains(&named), "{file} names it");
    }
    rig.ok("runs")
        .says(", own.toml\n")
        .says("; an airframe is named where it is not `paper`\n");
    assert_eq!(rig.run("runs", "--json").json()[0]["airframe"], "own.toml");
    // What the flight left refuses the file when it has changed; whole as it is, it needs no file.
    let left = rig.out().join("latest/settings.toml");
    let text = fs::read_to_string(&left).unwrap();
    let begin = text.find("\n[airframe]").unwrap();
    let end = begin
        + 1
        + text[begin + 1..]
            .find("\n[")
            .or(text[begin + 1..].find("\n#"))
            .unwrap();
    let referring = rig.settings(&(text[..begin].to_owned() + &text[end..]));
    fs::write(&file, OWN.replace("0.03", "0.031")).unwrap();
    let changed = rig.refused(&format!("simulate --config {referring}"));
    changed
        .complains(&format!("but the settings were made for a file with {sum}"))
        .complains("bring the old file back");
    fs::remove_file(&file).unwrap();
    rig.ok(&format!("simulate --config {}", left.to_str().unwrap()))
        .says(&named);
    rig.ok("replay").says(&named);
    let replayed = rig.ok("replay latest --verify");
    replayed.says(&format!("identical; outputs {}\n", simulated["outputs"]));
}

#[test]
fn ranges_follow_the_airframe() {
    let rig = Rig::new("ranges");
    let list = rig.ok("params --airframe crazyflie --json");
    let rows: serde_json::Value = serde_json::from_str(&list.stdout).unwrap();
    let mass = rows
        .as_array()
        .unwrap()
        .iter()
        .find(|row| row["name"] == "mass_kg")
        .unwrap();
    assert_eq!(mass["nominal"].as_f64(), Some(0.027));
    assert!((mass["max"].as_f64().unwrap() - 5.0 * 0.027 / 0.52).abs() < 1e-12);
}

#[test]
fn injections_go_by_the_airframe_that_flies() {
    let rig = Rig::new("injected-airframe");
    let slow = rig.slow(20);
    let flight = rig.take_off(format!(
        "--rt off --airframe x500 --config {slow} --duration 300ms"
    ));
    let nominal_kg = 2.064_307_692_3;
    let more = format!("  mass_kg  {nominal_kg:?} -> {:?} kg\n", nominal_kg * 1.1);
    rig.ok("inject mass_kg=+10%").says(&more);
    rig.ok("inject mass_kg=nominal")
        .says(&format!(" -> {nominal_kg:?} kg\n"));
    let light = rig.refused("inject mass_kg=0.1");
    light.complains("mass_kg = 0.1 is out of range: allowed are 0.198");
    let rows = rig.ok("params --json").json();
    assert_eq!(rows[0]["nominal"].as_f64(), Some(nominal_kg), "{rows}");
    flight.end().expect(0);
}

#[test]
fn what_is_printed_is_read_back_as_the_same_flight() {
    let rig = Rig::new("printed-airframe");
    let printed = rig.ok("fly --airframe x500 --print-config").stdout.clone();
    let config = rig.settings(&printed);
    let outputs = |args: &[&str]| {
        let told = rig
            .run("simulate", [&["--duration", "1s"], args].concat())
            .expect(0);
        told.result()["outputs"].clone()
    };
    assert_eq!(
        outputs(&["--config", &config]),
        outputs(&["--airframe", "x500"])
    );
}

#[test]
fn settings_of_one_airframe_are_not_mixed_with_another() {
    let rig = Rig::new("mixed-airframe");
    let file = rig.file("own.toml");
    fs::write(&file, OWN).unwrap();
    for (printed_for, flag) in [
        ("paper", "crazyflie"),
        ("x500", "paper"),
        (file.as_str(), "x500"),
        ("x500", &file),
    ] {
        let printed = rig
            .ok(&format!("fly --airframe {printed_for} --print-config"))
            .stdout
            .clone();
        let config = rig.settings(&printed);
        for command in ["fly", "simulate", "plant"] {
            let refused = rig
                .run(command, format!("--config {config} --airframe {flag}"))
                .expect(2);
            refused
                .complains(
                    "its whole sections [plant], [model], [rotor], [outer], [inner], [mixer] are of the airframe ",
                )
                .complains(&format!("`{printed_for}`, and would go before those of --airframe {flag}"))
                .complains(&format!("ironbird fly --airframe {flag} --print-config"));
        }
        rig.ok(&format!(
            "simulate --config {config} --airframe {printed_for} --duration 100ms"
        ));
    }
    // What somebody wrote is meant, for any airframe.
    let few = rig.settings("[model]\nmass_kg = 0.03\n[rotor]\nmin_rad_s = 0\nmax_rad_s = 2700\n");
    rig.ok(&format!(
        "simulate --config {few} --airframe crazyflie --duration 100ms"
    ));
    // A file that has changed is another airframe, though its name is the same.
    let config = rig.settings(
        &rig.ok(&format!("fly --airframe {file} --print-config"))
            .stdout,
    );
    fs::write(&file, OWN.replace("0.03", "0.031")).unwrap();
    let refused = rig.refused(&format!("simulate --config {config} --airframe {file}"));
    refused.complains("but the settings were made for a file with ");
    rig.assert_nothing_started();
}

#[test]
fn a_file_that_cannot_be_read_as_an_airframe_is_named() {
    let rig = Rig::new("bad-airframe");
    fs::write(rig.file("binary.toml"), [0xff, 0xfe, 0x00]).unwrap();
    fs::write(rig.file("locked.toml"), OWN).unwrap();
    fs::set_permissions(rig.file("locked.toml"), fs::Permissions::from_mode(0o000)).unwrap();
    fs::create_dir(rig.file("folder.toml")).unwrap();
    let may_read_all = fs::read(rig.file("locked.toml")).is_ok();
    for (file, told) in [
        (
            "binary.toml",
            "binary.toml: stream did not contain valid UTF-8",
        ),
        ("folder.toml", "folder.toml: it is not a regular file"),
        ("locked.toml", "locked.toml: Permission denied"),
    ] {
        if file == "locked.toml" && may_read_all {
            rig::not_tested("a file that may not be read: this user may read every file");
            continue;
        }
        for command in ["fly", "simulate", "plant", "record"] {
            rig.run(command, format!("--airframe {}", rig.file(file)))
                .expect(2)
                .complains(told);
        }
    }
    rig.assert_nothing_started();
}
