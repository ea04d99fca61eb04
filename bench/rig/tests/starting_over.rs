//! Starts in bad company: after processes that were killed, with little memory, with few files. Real processes.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::collections::BTreeMap;
use std::fs;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use rustix::process::Signal;

use crate::rig::{Rig, Running, in_own_mounts, rounds, send};

/// Children of a process, also those that have yet to become what they shall be.
fn children(pid: u32) -> Vec<u32> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).unwrap().map(|task| task.unwrap().path());
    let lists = tasks.map(|task| fs::read_to_string(task.join("children")).unwrap_or_default());
    lists.flat_map(|list| list.split_whitespace().map(|pid| pid.parse().unwrap()).collect::<Vec<_>>()).collect()
}

/// Kills a flight with all its processes at once, wherever they are.
fn kill_all(flight: Running) {
    flight.signal(Signal::STOP);
    let roles = children(flight.pid());
    roles.iter().for_each(|pid| send(*pid, Signal::KILL));
    flight.signal(Signal::KILL);
    flight.end();
}

/// Starts flights, kills each with all its processes within its first 0.2 s, starts again at once; says how each
/// second start went that was no flight.
fn start_over(rounds: u64) -> BTreeMap<String, u64> {
    let rig = Rig::new("over");
    let mut failures = BTreeMap::new();
    let slow = rig.slow(5);
    for round in 0..rounds {
        let flight = rig.start("fly", &["--rt", "off", "--duration", "1s"]);
        // Somewhere in the first 0.2 s, and everywhere in the course of the rounds.
        let instant_us = round.wrapping_mul(6_364_136_223_846_793_005).rotate_left(32) % 200_000;
        sleep(Duration::from_micros(instant_us));
        kill_all(flight);
        let next = rig.run("fly", &["--rt", "off", "--config", &slow, "--duration", "100ms"]);
        if next.code != Some(0) {
            let said =
                format!("code {:?}: {}", next.code, next.stderr.split_whitespace().collect::<Vec<_>>().join(" "));
            eprintln!("killed after {instant_us} us: {said}");
            *failures.entry(said).or_default() += 1;
        }
    }
    rig.assert_nothing_left();
    failures
}

#[test]
#[ignore = "long: part of the gate"]
fn a_start_after_a_start_that_was_killed_flies() {
    assert_eq!(start_over(10), BTreeMap::new());
}

#[test]
#[ignore = "long: part of the gate"]
fn five_roles_that_start_at_the_same_time_after_killed_ones_fly() {
    let rig = Rig::new("together");
    let slow = rig.slow(5);
    for round in 0..5 {
        let flight = rig.start("fly", &["--rt", "off", "--duration", "1s"]);
        sleep(Duration::from_millis(30 + 40 * round));
        kill_all(flight);
        let args = ["--rt", "off", "--config", &slow, "--duration", "100ms"];
        let roles = ["plant", "outer", "inner", "mixer", "record"].map(|role| rig.start(role, &args));
        for role in roles {
            role.end().expect(0);
        }
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn many_starts_after_starts_that_were_killed_fly() {
    let rounds = rounds();
    let failures = start_over(rounds);
    let failed: u64 = failures.values().sum();
    eprintln!("{rounds} rounds, {failed} failed");
    assert_eq!(failures, BTreeMap::new());
}

/// Starts the roles one after the other as by hand, each when the one before waits, where /dev/shm has 64 MiB.
const BY_HAND: &str = r#"
for role in plant outer inner mixer; do
    "$0" $role "$@" 2> $role.err &
    pids="$pids $!"
    until grep -q "waiting for" $role.err; do
        kill -0 $! || { cat $role.err; exit 98; }
        sleep 0.05
    done
done
"$0" inner "$@" 2> second.err
echo "second inner $?"
cat second.err
"$0" record "$@" || exit 97
for pid in $pids; do wait $pid || exit 96; done
"#;

#[test]
#[ignore = "long: part of the gate"]
fn five_roles_by_hand_fly_in_the_shared_memory_of_a_container() {
    let rig = Rig::new("container");
    let Some(mut roles) = in_own_mounts("mount -t tmpfs -o size=64m tmpfs /dev/shm", "true", "sh") else { return };
    roles.args(["-c", BY_HAND, rig::IRONBIRD]);
    roles.args(rig.own_args("plant", &["--config", &rig.slow(5), "--duration", "100ms"]));
    roles.env("IRONBIRD_ROOT", rig.root());
    let ended = rig.launch(roles).end().expect(0).says("second inner 5\n");
    ended.says("already has a running inner").says("RESULT status=PASS");
}

#[test]
fn too_few_inodes_are_named_with_the_remedy() {
    let rig = Rig::new("inodes");
    for inodes in [2, 3, 4, 6, 9, 12] {
        let mount = format!("mount -t tmpfs -o size=256m,nr_inodes={inodes} tmpfs /dev/shm");
        let Some(mut plant) = in_own_mounts(&mount, "true", rig::IRONBIRD) else { return };
        plant.arg("plant").args(rig.own_args("plant", &["--rt", "off"]));
        plant.env("IRONBIRD_ROOT", rig.root());
        let plant = rig.launch(plant).end();
        assert!(matches!(plant.code, Some(1 | 2)), "{inodes} inodes: {plant}");
        assert!(!plant.stderr.contains("ironbird clean"), "{inodes} inodes: {plant}");
        plant.complains("/dev/shm");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn too_few_files_are_named_with_the_remedy() {
    let mut refused = 0;
    for files in [20, 40, 56, 64, 72, 76, 80, 84, 100] {
        let rig = Rig::new("files");
        let slow = rig.slow(5);
        let args = ["--rt", "off", "--config", &slow, "--duration", "100ms"];
        let mut plant = Command::new("sh");
        plant.args(["-c", "ulimit -n $1; shift; exec \"$@\"", "sh", &files.to_string(), rig::IRONBIRD, "plant"]);
        plant.args(rig.own_args("plant", &args)).env("IRONBIRD_ROOT", rig.root());
        let others = ["outer", "inner", "mixer"].map(|role| rig.start(role, &args));
        let record = rig.start("record", &args);
        let plant = rig.launch(plant).end();
        if plant.code != Some(0) {
            refused += 1;
            assert!(matches!(plant.code, Some(1 | 2)), "{files} files: {plant}");
            let plant = plant.complains("ulimit -n 1024");
            // The system's own words begin with a capital.
            assert!(plant.stderr.to_lowercase().contains("too many open files"), "{files} files: {plant}");
            assert!(!plant.stderr.contains("ironbird clean"), "{files} files: {plant}");
        }
        // Without a plant they wait; with one, they end with it.
        for mut role in others.into_iter().chain([record]) {
            if role.is_running() {
                role.signal(Signal::TERM);
            }
            role.end();
        }
    }
    assert!(refused > 0, "no limit was too low: the test has lost its subject");
}
