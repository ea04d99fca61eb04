//! What a machine refuses, and mistakes that need a flight. Wrong arguments and files are pages in `refusals/`.

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{IRONBIRD, Rig, wait_until};
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
fn a_file_that_is_not_writable_is_named_and_the_check_neither_creates_nor_changes_it() {
    let rig = Rig::new("untouched");
    let states = rig.file("states.csv");
    let refused = || {
        rig.run("fly", ["--states", &states, "--instance", "Left Rig"])
            .expect(2)
    };
    refused();
    assert!(!fs::exists(&states).unwrap());
    fs::write(&states, "kept").unwrap();
    refused();
    assert_eq!(fs::read_to_string(&states).unwrap(), "kept");

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
fn a_report_with_numbers_of_no_flight_is_refused() {
    let rig = Rig::new("crafted");
    rig.ok("fly --pace lockstep --duration 50ms");
    let whole = rig.report();
    for (place, value, words) in [
        // Sums of such counts do not fit.
        (
            "/ticks/skipped",
            json!(u64::MAX),
            "ticks.skipped = 18446744073709551615 is no count of a flight",
        ),
        (
            "/series/0/max_us",
            json!(1e308),
            "series[0].max_us = 1e+308 is no number of a flight",
        ),
    ] {
        let mut report = whole.clone();
        *report.pointer_mut(place).unwrap() = value;
        let path = rig.out().join("latest/report.json");
        fs::write(path, report.to_string()).unwrap();
        for format in ["html", "text"] {
            let refused = rig.run("report", format!("--format {format}")).expect(1);
            refused.complains(words).complains("report.json");
        }
    }
}

#[test]
fn directories_that_cannot_be_used_are_named_with_the_remedy() {
    let rig = Rig::new("places");
    let long = format!("/tmp/{}", "x".repeat(60));
    for (root, words) in [
        ("/proc/nope", "cannot use /proc/nope/"),
        ("/proc/nope", "another one in IRONBIRD_ROOT"),
        (
            &*long,
            "is 65 characters long; iceoryx2's paths below it need it to be at most 64",
        ),
    ] {
        let mut command = rig.command("fly", "--rt off");
        command.env("IRONBIRD_ROOT", root);
        rig.launch(command).end().expect(2).complains(words);
    }
    assert!(!fs::exists(long).unwrap());
    rig.assert_nothing_started();
    rig.refused("fly --rt off --out /proc/nope");
    // What was made for the flight is gone.
    assert!(!rig.root().join(&rig.instance).exists());
    rig.assert_nothing_left();
}

#[test]
fn too_little_shared_memory_and_a_trace_that_is_not_granted_are_refused_before_anything_starts() {
    let rig = Rig::new("small-shm");
    let small = "shared memory is too small: /dev/shm has 4 MiB free, this instance needs ";
    let enlarge = "enlarge it: mount -o remount,size=256M /dev/shm";
    // An empty directory where the kernel would have its traces.
    let no_traces = "mount -t tmpfs tmpfs /sys/kernel/tracing";
    let inodes = |count| format!("mount -t tmpfs -o size=256m,nr_inodes={count} tmpfs /dev/shm");
    let size = |size| format!("mount -t tmpfs -o size={size} tmpfs /dev/shm");
    let trace = ["cannot trace the loops' processor", "without --trace"];
    let mut cases = vec![
        (size("4m"), "fly", "", [small, enlarge]),
        (size("4m"), "plant", "", [small, enlarge]),
        (no_traces.into(), "fly", "--trace", trace),
        (no_traces.into(), "record", "--trace", trace),
    ];
    for count in [2, 3, 4, 6, 9, 12] {
        cases.push((inodes(count), "plant", "", ["/dev/shm", ""]));
    }
    for (mount, command, flag, words) in cases {
        let args = format!("--rt off --duration 100ms {flag}");
        let Some(command) = rig.command_in_mounts((&mount, "true"), command, args) else {
            return;
        };
        let refused = rig.launch(command).end();
        assert!(matches!(refused.code, Some(1 | 2)), "{mount}: {refused}");
        let refused = refused.complains(words[0]).complains(words[1]);
        if mount.contains("inodes") {
            assert!(!refused.stderr.contains("ironbird clean"), "{refused}");
        } else {
            rig.assert_nothing_started();
        }
    }
    // That of a container is enough.
    let args = rig.slowly(5, "100ms");
    let container = rig.command_in_mounts((&size("64m"), "true"), "fly", args);
    rig.launch(container.unwrap()).end().expect(0);
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
    for command in ["fly", "simulate"] {
        rig.run(command, &faults)
            .expect(2)
            .complains("the settings that the processes share are ")
            .complains("bytes long: allowed are 8192, and flight.faults takes ")
            .complains("help: put values that");
    }
    rig.assert_nothing_started();
}

#[test]
fn an_injection_names_the_range_of_the_airframe_that_flies_also_for_the_impossible() {
    let rig = Rig::new("impossible");
    rig.refused("inject mass_kg=-1").complains(
        "mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg for the airframe `paper`, and no other",
    );
    let quoted = rig.file("it's \"so\".csv");
    fs::write(&quoted, "t,x,y,z,yaw\n0,0,0,0,0\n5,0,0,0.1,0\n").unwrap();
    let slow = rig.slow(10);
    let options =
        format!("--rt off --airframe crazyflie --config {slow} --duration 1h --trajectory");
    let mut words: Vec<&str> = options.split(' ').collect();
    words.push(&quoted);
    let flight = rig.take_off(words);
    for value in ["-1", "1e300", "600"] {
        let refused = rig.refused(&format!("inject mass_kg={value}"));
        refused.complains(&format!(
            "mass_kg = {value} is out of range: allowed are 0.00259"
        ));
    }
    let refused = rig.refused(&format!("inject mass_kg={}", "1".repeat(300)));
    assert!(refused.stderr.len() < 400, "{refused}");
    // Observers read the flight's settings, with the name of its file, whatever is in it.
    let watch = rig.start("watch", "--plain");
    wait_until("a line", || {
        watch.stdout().contains("   error ").then_some(())
    });
    flight.interrupt().expect(130);
    watch.end().expect(0);
}
