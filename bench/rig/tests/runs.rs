//! `ironbird runs`: the list of flights, and what its pruning removes and what it never does.

use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::rig::unprivileged::unprivileged;
use crate::rig::{Ended, Rig, wait_until};
use rustix::process::Signal;
use serde_json::Value;

const SHORT: &str = "--pace lockstep --duration 50ms --fault mass_kg=0.6@tick20";

/// A rig with so many flights, and their directories, the oldest first.
fn flown(name: &str, flights: usize) -> (Rig, Vec<PathBuf>) {
    let rig = Rig::new(name);
    (0..flights).for_each(|_| drop(rig.run("fly", SHORT).expect(0)));
    let directories: Vec<PathBuf> = rig
        .run_directories()
        .iter()
        .map(|name| rig.out().join(name))
        .collect();
    assert_eq!(directories.len(), flights);
    (rig, directories)
}

fn runs(rig: &Rig, args: &[&str]) -> Ended {
    rig.run("runs", args)
}

fn there(directories: &[PathBuf]) -> Vec<bool> {
    directories
        .iter()
        .map(|directory| directory.exists())
        .collect()
}

fn name_of(directory: &Path) -> &str {
    directory.file_name().unwrap().to_str().unwrap()
}

#[test]
fn flights_are_listed_with_what_became_of_them() {
    let (rig, directories) = flown("listed", 2);
    fs::create_dir(rig.out().join("notes")).unwrap();
    fs::write(rig.out().join("README"), "no flight").unwrap();
    let listed = runs(&rig, &[]).expect(0);
    let lines: Vec<&str> = listed.stdout.lines().collect();
    assert!(
        lines.iter().all(|line| line.chars().count() <= 80),
        "{listed}"
    );
    let [head, newest, oldest, sum, late] = lines[..] else {
        panic!("{listed}")
    };
    assert_eq!(
        head.split_whitespace().collect::<Vec<_>>()[..5],
        ["flight", "length", "late", "size", "status"]
    );
    assert!(
        newest.starts_with(name_of(&directories[1])) && newest.contains(" * "),
        "the newest comes first: {listed}"
    );
    assert!(
        oldest.starts_with(name_of(&directories[0])) && !oldest.contains('*'),
        "{listed}"
    );
    assert!(
        newest.contains("0.1s") && newest.contains("  PASS ") && newest.contains(", not measured"),
        "{listed}"
    );
    assert_eq!(
        late,
        "late: ticks without a fresh command on time (missed + stale + skipped)"
    );
    assert!(
        sum.starts_with("2 flights in ") && sum.ends_with("* is `latest`"),
        "{listed}"
    );
    let listed = runs(&rig, &["--json"]).expect(0).json();
    let [newest, _] = &listed.as_array().unwrap()[..] else {
        panic!("{listed}")
    };
    let report = rig.report();
    assert_eq!(
        (&newest["name"], &newest["is_latest"]),
        (&name_of(&directories[1]).into(), &true.into())
    );
    assert_eq!(
        (&newest["status"], &newest["missed"], &newest["started"]),
        (&"PASS".into(), &0.into(), &report["run"]["started"])
    );
    let bytes: u64 = files(&directories[1])
        .iter()
        .map(|path| fs::metadata(path).unwrap().len())
        .sum();
    assert_eq!(
        (&newest["bytes"], &newest["length_s"]),
        (&bytes.into(), &0.051.into())
    );
}

fn files(directory: &Path) -> Vec<PathBuf> {
    fs::read_dir(directory)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect()
}

#[test]
fn old_flights_go_with_all_their_files_and_the_newest_stay() {
    let (rig, directories) = flown("pruned", 3);
    for format in ["csv", "json", "perfetto"] {
        let args = format!("{} --format {format}", directories[0].to_str().unwrap());
        rig.run("export", &args).expect(0);
    }
    let would = runs(&rig, &["--prune", "--keep", "1", "--dry-run"]).expect(0);
    let would = would
        .says(&format!("would remove {} (", name_of(&directories[0])))
        .says("2 flights, ");
    assert!(
        would.stdout.contains("would be removed") && there(&directories) == [true; 3],
        "{would}"
    );
    runs(&rig, &["--prune", "--keep", "1"])
        .expect(0)
        .says(&format!("removed {} (", name_of(&directories[1])));
    assert_eq!(there(&directories), [false, false, true]);
    runs(&rig, &["--prune", "--keep", "1"])
        .expect(0)
        .says("0 flights, 0.0kB removed");
    runs(&rig, &[]).expect(0).says("1 flight in ");
}

#[test]
fn flights_go_by_their_age_and_the_latest_never_does() {
    let (rig, directories) = flown("aged", 2);
    runs(&rig, &["--prune", "--older-than", "1h"])
        .expect(0)
        .says("0 flights, ");
    assert_eq!(there(&directories), [true; 2]);
    runs(&rig, &["--prune", "--older-than", "0s"])
        .expect(0)
        .says("`latest` points to it")
        .says("1 flight, ");
    assert_eq!(there(&directories), [false, true]);
    rig.ok("report");
}

#[test]
fn flights_that_resist_are_named_and_the_others_go() {
    let (rig, directories) = flown("resisting", 3);
    let Some(prune) = unprivileged(&rig, "runs", "--prune --keep 1") else {
        return;
    };
    // The files of the first may not be removed; those of the second may, as may its directory.
    let may =
        |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    [&rig.out(), &directories[1]]
        .into_iter()
        .for_each(|path| may(path, 0o777));
    may(&directories[0], 0o555);
    let pruned = rig
        .launch(prune)
        .end()
        .expect(1)
        .complains("1 flight could not be removed");
    may(&directories[0], 0o755);
    let pruned = pruned.says(&format!(
        "partly removed {}: cannot remove {}/",
        name_of(&directories[0]),
        directories[0].display()
    ));
    pruned
        .says(": Permission denied")
        .says(&format!("removed {} (", name_of(&directories[1])))
        .says("1 flight, ");
    assert_eq!(there(&directories), [true, false, true]);
}

#[test]
fn what_ironbird_has_not_made_stays_and_so_does_its_directory() {
    let (rig, directories) = flown("foreign", 4);
    fs::write(directories[0].join("notes.txt"), "mine").unwrap();
    fs::create_dir(directories[1].join("plots")).unwrap();
    fs::create_dir(directories[2].join("export")).unwrap();
    fs::write(directories[2].join("export/mine.csv"), "mine").unwrap();
    // No flight's, though it is called like one; and one that is elsewhere.
    let other = rig.out().join("2020-01-01T00-00-00Z");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("run.json"), "{\"name\": \"of another program\"}").unwrap();
    let elsewhere = rig.path("elsewhere");
    fs::rename(&directories[0], &elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, &directories[0]).unwrap();
    let pruned = runs(&rig, &["--prune", "--keep", "1"])
        .expect(0)
        .says("0 flights, ");
    let pruned = pruned
        .says("/plots was not created by ironbird\n")
        .says("/export/mine.csv was not created by ironbird\n");
    assert!(
        !pruned
            .stdout
            .contains(&format!("{}:", name_of(&directories[0]))),
        "what a link leads to is not looked at: {pruned}"
    );
    assert_eq!(there(&directories), [true; 4]);
    for kept in [
        other.join("run.json"),
        elsewhere.join("notes.txt"),
        elsewhere.join("run.json"),
        directories[2].join("flight.mcap"),
    ] {
        assert!(kept.exists(), "{}", kept.display());
    }
}

#[test]
fn a_flight_in_the_air_is_listed_as_that_and_left_alone() {
    let rig = Rig::new("aloft");
    let flight = rig.take_off(format!("--rt off --duration 1h --config {}", rig.slow(20)));
    wait_until("the flight to be listed", || {
        let listed = runs(&rig, &["--json"]).json();
        (listed[0]["status"] == "in the air" && listed[0]["is_latest"] == true).then_some(())
    });
    fs::remove_file(rig.out().join("latest")).unwrap();
    runs(&rig, &["--prune", "--older-than", "0s"])
        .expect(0)
        .says("its processes are running")
        .says("0 flights, ");
    flight.signal(Signal::INT);
    flight.end().expect(130);
    let listed: Value = runs(&rig, &["--json"]).expect(0).json();
    assert_eq!(listed[0]["status"], "INTERRUPTED");
}

#[test]
fn flights_without_a_report_are_listed_and_can_go() {
    let (rig, directories) = flown("reportless", 2);
    let begun = &directories[0];
    for path in files(begun)
        .iter()
        .filter(|path| !path.ends_with("run.json"))
    {
        fs::remove_file(path).unwrap();
    }
    let long_ago = SystemTime::now() - Duration::from_secs(100 * 86_400);
    File::options()
        .write(true)
        .open(begun.join("run.json"))
        .unwrap()
        .set_modified(long_ago)
        .unwrap();
    runs(&rig, &[]).expect(0).says("no report  -\n");
    fs::write(
        begun.join("report.json"),
        "{\"schema\": \"of another version\"}",
    )
    .unwrap();
    runs(&rig, &[]).expect(0).says("unreadable  -\n");
    runs(&rig, &["--prune", "--older-than", "30d"])
        .expect(0)
        .says("1 flight, ");
    assert_eq!(there(&directories), [false, true]);
}

#[test]
fn a_flight_that_waits_for_its_processes_is_not_pruned() {
    let rig = Rig::new("waits");
    let record = rig.start("record", "");
    wait_until("the directory of the flight", || {
        rig.run_directories().pop()
    });
    let out = rig.out().to_str().unwrap().to_owned();
    rig.ok(&format!("runs --out {out}")).says("starting");
    rig.ok(&format!("runs --prune --older-than 0s --out {out}"))
        .says("kept ")
        .says("0 flights");
    assert_eq!(rig.run_directories().len(), 1);
    record.signal(Signal::TERM);
    record.end().expect(130);
}

#[test]
fn a_pipe_in_place_of_a_file_holds_nobody_up() {
    let rig = Rig::new("pipes");
    rig.ok("fly --pace lockstep --duration 100ms");
    let out = rig.out().to_str().unwrap().to_owned();
    let whole = rig.run_directories().pop().unwrap();
    for file in ["run.json", "report.json", "latency.hlog", "flight.mcap"] {
        let directory = rig.out().join(format!("with-a-pipe-for-{file}"));
        fs::create_dir(&directory).unwrap();
        for kept in ["run.json", "report.json", "flight.mcap"]
            .iter()
            .filter(|kept| **kept != file)
        {
            fs::copy(rig.out().join(&whole).join(kept), directory.join(kept)).unwrap();
        }
        assert!(
            Command::new("mkfifo")
                .arg(directory.join(file))
                .status()
                .unwrap()
                .success()
        );
    }
    let listed = rig.ok(&format!("runs --json --out {out}")).json();
    let status = |file: &str| {
        let name = format!("with-a-pipe-for-{file}");
        let run = listed
            .as_array()
            .unwrap()
            .iter()
            .find(|run| run["name"] == *name)?;
        Some(run["status"].as_str().unwrap().to_owned())
    };
    let told = ["run.json", "report.json", "latency.hlog", "flight.mcap"].map(status);
    assert_eq!(
        told,
        [
            None,
            Some("unreadable".into()),
            Some("PASS".into()),
            Some("PASS".into())
        ]
    );
    rig.ok(&format!("runs --prune --keep 100 --out {out}"));
    for command in [
        &["export", "with-a-pipe-for-flight.mcap"][..],
        &["replay", "with-a-pipe-for-flight.mcap"],
    ] {
        let ended = rig.run(command[0], &command[1..]);
        assert!(matches!(ended.code, Some(1 | 2)), "{ended}");
        ended.complains("is not a regular file");
    }
}

#[test]
fn a_directory_without_flights_has_an_empty_list() {
    let rig = Rig::new("empty");
    fs::create_dir(rig.out()).unwrap();
    let said = format!("{} holds no flight\n", rig.out().display());
    assert_eq!(rig.ok("runs").stdout, said);
    assert_eq!(rig.ok("runs --json").stdout, "[]\n");
}
