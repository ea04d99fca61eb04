//! Wrong use, and what the machine refuses. Wrong arguments and files are pages in `refusals/`.

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{self, IRONBIRD, Rig, in_own_mounts, not_tested};
use rustix::process::Signal;
use serde_json::json;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

#[test]
fn no_command_is_answered_with_the_usage() {
    let rig = Rig::new("help");
    let ended = rig.launch(Command::new(IRONBIRD)).end().expect(2);
    ended.complains("Usage: ironbird");
    rig.assert_nothing_started();
}

#[test]
fn asking_whether_a_file_can_be_written_does_not_make_it() {
    let rig = Rig::new("untouched");
    let states = rig.file("states.csv");
    rig.run("fly", ["--states", &states, "--instance", "Left Rig"])
        .expect(2);
    assert!(!fs::exists(&states).unwrap());
    fs::write(&states, "kept").unwrap();
    rig.run("fly", ["--states", &states, "--instance", "Left Rig"])
        .expect(2);
    assert_eq!(fs::read_to_string(&states).unwrap(), "kept");
}

#[test]
fn a_report_with_numbers_of_no_flight_is_refused() {
    let rig = Rig::new("crafted");
    rig.ok(&format!(
        "fly --rt off --config {} --duration 50ms",
        rig.slow(5)
    ));
    let path = rig.out().join("latest/report.json");
    let whole = rig.report();
    for (place, value, words) in [
        (
            "/series/0/max_us",
            json!(1e308),
            "series[0].max_us = 1e+308 is no number of a flight",
        ),
        // Sums of such counts do not fit.
        (
            "/ticks/skipped",
            json!(u64::MAX),
            "ticks.skipped = 18446744073709551615 is no count of a flight",
        ),
    ] {
        let mut report = whole.clone();
        *report.pointer_mut(place).unwrap() = value;
        fs::write(&path, report.to_string()).unwrap();
        for format in ["html", "text"] {
            rig.run("report", format!("--format {format}"))
                .expect(1)
                .complains(words)
                .complains("report.json");
        }
    }
}

#[test]
fn directories_that_cannot_be_used_are_named_with_the_remedy() {
    let rig = Rig::new("places");
    let with_root = |root: &str| {
        let mut command = rig.command("fly", "--rt off");
        command.env("IRONBIRD_ROOT", root);
        rig.launch(command).end().expect(2)
    };
    with_root("/proc/nope")
        .complains("cannot use /proc/nope/")
        .complains("another one in IRONBIRD_ROOT");
    let long = format!("/tmp/{}", "x".repeat(60));
    with_root(&long)
        .complains("is 65 characters long; iceoryx2's paths below it need it to be at most 64");
    assert!(!fs::exists(long).unwrap());
    rig.assert_nothing_started();
    rig.refused("fly --rt off --out /proc/nope");
    assert!(
        !rig.root().join(&rig.instance).exists(),
        "what was made for the flight is gone"
    );
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn without_privilege_real_time_is_refused_when_required_and_reported_when_preferred() {
    let rig = Rig::new("nobody");
    let slow = rig.slow(5);
    let args = |mode| ["--rt", mode, "--config", &slow, "--duration", "50ms"];
    let Some(required) = fly_unprivileged(&rig, args("require")) else {
        return;
    };
    if required.code == Some(0) {
        not_tested("this user is granted real time");
        return;
    }
    required
        .expect(4)
        .complains("real time was required and not granted to the")
        .complains("Scheduler (Operation not permitted (os error 1))")
        .complains("raise the rtprio limit")
        .complains("raise the memlock limit")
        .complains(
            "or fly with what is granted: --rt prefer; without root the same laws fly in lockstep",
        );
    rig.assert_nothing_left();
    let preferred = fly_unprivileged(&rig, args("prefer")).unwrap().expect(0);
    assert_eq!(preferred.result()["rt"], "other", "{preferred}");
    // Once for all loops, with what he can do.
    let preferred = preferred
        .says("\nRefused   ")
        .tells("scheduler to all loops: Operation not permitted");
    preferred.tells("those that need no root are --pace lockstep, flight.slowdown (slow motion)");
    rig.ok("report --section processes")
        .says("REFUSED (Operation not permitted (os error 1))");
    rig.assert_nothing_left();
}

#[test]
fn a_file_that_a_user_may_not_write_is_named_with_what_to_do() {
    let rig = Rig::new("forbidden");
    let closed = rig.path("closed");
    fs::create_dir(&closed).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o500)).unwrap();
    let states = closed.join("states.csv").display().to_string();
    let Some(ended) = fly_unprivileged(&rig, format!("--states {states}")) else {
        return;
    };
    let ended = ended.expect(2).complains(&format!(
        "--states: cannot write {states}: Permission denied"
    ));
    ended.complains("help: name a file in a directory that is there and that you can write");
    rig.assert_nothing_left();
}

#[test]
fn too_little_shared_memory_is_said_before_anything_starts_and_that_of_a_container_is_enough() {
    let rig = Rig::new("small-shm");
    let slow = rig.slow(5);
    for (command, size) in [("fly", "4m"), ("plant", "4m"), ("fly", "64m")] {
        let mount = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm");
        let Some(mut small) = in_own_mounts(&mount, "true", IRONBIRD) else {
            return;
        };
        let args = format!("--rt off --config {slow} --duration 100ms");
        small.arg(command).args(rig.own_args(command, args));
        small.env("IRONBIRD_ROOT", rig.root());
        let ended = rig.launch(small).end();
        if size == "64m" {
            drop(ended.expect(0));
            continue;
        }
        ended
            .expect(1)
            .complains("shared memory is too small: /dev/shm has 4 MiB free, this instance needs ")
            .complains("enlarge it: mount -o remount,size=256M /dev/shm");
        rig.assert_nothing_started();
    }
}

#[test]
fn a_trace_that_the_kernel_does_not_give_is_refused_before_anything_starts() {
    let rig = Rig::new("untraced");
    // An empty directory where the kernel would have its traces.
    for command in ["fly", "record"] {
        let Some(mut traced) =
            in_own_mounts("mount -t tmpfs tmpfs /sys/kernel/tracing", "true", IRONBIRD)
        else {
            return;
        };
        traced
            .args([command, "--trace"])
            .args(rig.own_args(command, "--duration 1s"));
        traced.env("IRONBIRD_ROOT", rig.root());
        let refused = rig.launch(traced).end().expect(1);
        refused
            .complains("cannot trace the loops' processor")
            .complains("without --trace");
        rig.assert_nothing_started();
    }
    rig.assert_nothing_left();
}

#[test]
fn an_airframe_without_weight_or_drag_torque_flies_without_a_warning() {
    let rig = Rig::new("weightless");
    for text in [
        "[plant]\ngravity_m_s2 = 0\n",
        "[airframe]\ndrag_factor_nm_s2 = 0\n",
    ] {
        let config = rig.settings(text);
        let flown = rig.ok(&format!("simulate --config {config} --duration 100ms"));
        assert!(!flown.stderr.contains("warning"), "{text}: {flown}");
    }
}

#[test]
fn a_whole_airframe_has_its_own_rotors() {
    let rig = Rig::new("wrong-rotors");
    let printed = rig.ok("fly --airframe crazyflie --print-config").stdout;
    let (before, after) = printed.split_once("\n[rotor]").unwrap();
    let without = rig.settings(&format!("{before}{}", &after[after.find("\n[").unwrap()..]));
    rig.refused(&format!("simulate --config {without}"))
        .complains("settings file")
        .complains("a whole section [airframe] has its own rotors")
        .complains("help: write them beside it: [rotor] with min_rad_s and max_rad_s");
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
        let refused = rig
            .run(command, &flags)
            .expect(2)
            .complains("the settings that the processes share are ");
        refused
            .complains("bytes long: allowed are 8192, and flight.faults takes ")
            .complains("help: put values that");
    }
    rig.assert_nothing_started();
}

#[test]
fn an_injection_names_the_range_of_the_airframe_that_flies_also_for_the_impossible() {
    let rig = Rig::new("impossible");
    let grounded = rig.refused("inject mass_kg=-1");
    grounded
        .complains("mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg for the airframe `paper`, and no other");
    let quoted = rig.file("it's \"so\".csv");
    fs::write(&quoted, "t,x,y,z,yaw\n0,0,0,0,0\n5,0,0,0.1,0\n").unwrap();
    let slow = rig.slow(10);
    let options =
        format!("--rt off --airframe crazyflie --config {slow} --duration 1h --trajectory");
    let words = options.split(' ').chain([quoted.as_str()]);
    let flight = rig.take_off(words.collect::<Vec<_>>());
    for value in ["-1", "1e300", "600"] {
        let refused = rig.refused(&format!("inject mass_kg={value}"));
        refused.complains(&format!(
            "mass_kg = {value} is out of range: allowed are 0.00259"
        ));
    }
    let digits = "1".repeat(300);
    let refused = rig.refused(&format!("inject mass_kg={digits}"));
    assert!(refused.stderr.len() < 400, "{refused}");
    // Whoever reads the flight's settings reads the name of its file, whatever is in it.
    let watch = rig.start("watch", "--plain");
    rig::wait_until("a line", || {
        watch.stdout().contains("   error ").then_some(())
    });
    flight.signal(Signal::INT);
    flight.end().expect(130);
    watch.end().expect(0);
}
