//! Trajectories of a file: flown, replayed without it, refused where roles differ; what is too quick is said before.

use std::fs;

use crate::rig::Rig;

const CLIMB: &str = "t,x,y,z,yaw\n0,0,0,0,0\n2,0.5,0,0.5,0\n4,1,-0.5,1,0.5\n";

#[test]
fn a_file_flies_in_processes_as_in_simulation_and_is_replayed_without_it() {
    let rig = Rig::new("points");
    let file = rig.file("climb.csv");
    fs::write(&file, CLIMB).unwrap();
    let flight = format!("--trajectory {file} --duration 600ms");
    let flown = rig.ok(&format!("fly {flight} --pace lockstep"));
    flown.says("trajectory climb.csv, gains flight");
    let simulated = rig.run("simulate", &flight).expect(0).result();
    fs::remove_file(&file).unwrap();
    let replayed = rig.ok("replay latest --verify");
    replayed.says(&format!("identical; outputs {}\n", simulated["outputs"]));
}

#[test]
fn a_flight_ends_where_its_points_end() {
    let rig = Rig::new("points-end");
    let (file, states) = (rig.file("climb.csv"), rig.file("states.csv"));
    fs::write(&file, CLIMB).unwrap();
    rig.ok(&format!(
        "simulate --trajectory {file} --duration 20s --states {states}"
    ));
    let text = fs::read_to_string(&states).unwrap();
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let last: Vec<&str> = lines.next_back().unwrap().split(',').collect();
    let number = |name: &str| {
        let column = header
            .iter()
            .position(|it| *it == name)
            .unwrap_or_else(|| panic!("{name} in {header:?}"));
        last[column].parse::<f64>().unwrap()
    };
    for (name, wanted) in [("x", 1.0), ("y", -0.5), ("z", 1.0)] {
        assert!(
            (number(name) - wanted).abs() < 0.01,
            "{name} = {}",
            number(name)
        );
    }
}

#[test]
fn a_changed_file_is_refused_by_both_hashes() {
    let rig = Rig::new("points-changed");
    let file = rig.file("climb.csv");
    fs::write(&file, CLIMB).unwrap();
    let printed = rig
        .ok(&format!("fly --trajectory {file} --print-config"))
        .stdout
        .clone();
    let hash = printed
        .split("\nsha256 = \"")
        .nth(1)
        .unwrap()
        .split('"')
        .next()
        .unwrap()
        .to_owned();
    assert_eq!(hash.len(), 64);
    let config = rig.settings(&printed);
    rig.ok(&format!("simulate --config {config} --duration 100ms"));
    fs::write(&file, CLIMB.replace("0.5,0,0.5", "0.5,0,0.6")).unwrap();
    for command in ["simulate", "outer", "record"] {
        let refused = rig.run(command, format!("--config {config}")).expect(2);
        refused
            .complains("its SHA-256 is ")
            .complains(&format!("but the settings were made for {hash}"));
    }
    // The flag names another trajectory, of which the settings have no sum.
    let other = rig.file("other.csv");
    fs::write(&other, CLIMB.replace("0.5,0,0.5", "0.5,0,0.7")).unwrap();
    let prints = |trajectory: &str| {
        let args = format!("--config {config} --trajectory {trajectory} --print-config");
        rig.run("fly", &args)
            .expect(0)
            .stdout
            .split("\nsha256 = \"")
            .nth(1)
            .unwrap()
            .split('"')
            .next()
            .unwrap()
            .to_owned()
    };
    assert_eq!(prints("hover"), "");
    assert!(prints(&other).len() == 64 && prints(&other) != hash);
    rig.refused(&format!("simulate --config {config} --trajectory {file}"))
        .complains("its SHA-256 is ");
    rig.assert_nothing_started();
}

#[test]
fn a_file_that_cannot_be_read_as_points_is_named() {
    let rig = Rig::new("bad-points");
    fs::create_dir(rig.file("folder.csv")).unwrap();
    fs::write(
        rig.file("binary.csv"),
        b"t,x,y,z,yaw\n0,0,0,0,0\n\xff,0,0,0,0\n",
    )
    .unwrap();
    fs::write(rig.file("long.csv"), vec![b'0'; (4 << 20) + 1]).unwrap();
    for (file, told) in [
        ("long.csv", "long.csv: it is longer than 4 MiB"),
        ("folder.csv", "folder.csv: it is not a regular file"),
        ("binary.csv", "binary.csv: line 3 is not UTF-8"),
    ] {
        for command in ["fly", "simulate", "outer"] {
            rig.run(command, format!("--trajectory {}", rig.file(file)))
                .expect(2)
                .complains(told);
        }
    }
    rig.assert_nothing_started();
}

#[test]
fn what_is_too_quick_is_said_before_the_flight_with_its_instant() {
    let rig = Rig::new("too-quick");
    let quick =
        rig.settings("[flight]\ntrajectory = \"fast\"\n[trajectory]\nperiod = 0.5\nsize = 0.5\n");
    let flown = rig.run("simulate", format!("--config {quick} --duration 8s"));
    flown
        .complains("warning: trajectory fast asks for a tilt of ")
        .complains("outer.tilt_max_rad is 0.6109");
    let jump = rig.ok("simulate --trajectory step --duration 1s");
    jump.complains("warning: trajectory step begins with a jump: 1.732 m or rad away");
    let aloft =
        rig.settings("[flight]\ntrajectory = \"hover\"\n[initial]\nposition_w_m = [0, 0, 3]\n");
    rig.run("simulate", format!("--config {aloft} --duration 1s"))
        .complains("warning: trajectory hover begins with a jump: 3.000 m or rad away");
    let calm = rig.ok("simulate --trajectory lissajous --duration 1s");
    assert_eq!(calm.stderr, "");
}
