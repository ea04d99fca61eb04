//! `ironbird runs`: the list of flights, and which of them and of their files pruning removes.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::rig::unprivileged::unprivileged;
use crate::rig::{Rig, files_below, wait_until};
use rustix::process::Signal;

/// A rig with some flights, and their directories, the oldest first.
fn flown<const FLIGHTS: usize>(name: &str) -> (Rig, [PathBuf; FLIGHTS]) {
    let rig = Rig::new(name);
    for _ in 0..FLIGHTS {
        rig.ok("fly --pace lockstep --duration 50ms --fault mass_kg=0.6@tick20");
    }
    let names = rig.run_directories();
    let directories: Vec<PathBuf> = names.iter().map(|name| rig.out().join(name)).collect();
    (rig, directories.try_into().unwrap())
}

fn exist<const N: usize>(directories: &[PathBuf; N]) -> [bool; N] {
    directories.each_ref().map(|directory| directory.exists())
}

fn name_of(directory: &Path) -> &str {
    directory.file_name().unwrap().to_str().unwrap()
}

#[test]
fn flights_are_listed_with_their_results() {
    let (rig, [old, new]) = flown("listed");
    fs::create_dir(rig.out().join("notes")).unwrap();
    fs::write(rig.out().join("README"), "no flight").unwrap();
    let listed = rig.ok("runs");
    let lines: Vec<&str> = listed.stdout.lines().collect();
    assert!(
        lines.iter().all(|line| line.chars().count() <= 80),
        "{listed}"
    );
    let [head, newest, oldest, sum, late] = lines[..] else {
        panic!("{listed}")
    };
    let columns: Vec<&str> = head.split_whitespace().take(5).collect();
    assert_eq!(columns, ["flight", "length", "late", "size", "status"]);
    assert!(newest.starts_with(name_of(&new)), "{listed}");
    assert!(
        oldest.starts_with(name_of(&old)) && !oldest.contains('*'),
        "{listed}"
    );
    for words in [" * ", "0.1s", "  PASS ", ", not measured"] {
        assert!(newest.contains(words), "no `{words}` in {newest}");
    }
    assert!(
        late.starts_with("late: ticks without a fresh command on time"),
        "{listed}"
    );
    assert!(
        sum.starts_with("2 flights in ") && sum.ends_with("* is `latest`"),
        "{listed}"
    );
    let listed = rig.ok("runs --json").json();
    let sizes = files_below(&new)
        .into_iter()
        .map(|path| fs::metadata(path).unwrap().len());
    let (newest, bytes) = (&listed[0], sizes.sum::<u64>());
    for (key, value) in [
        ("name", name_of(&new).into()),
        ("is_latest", true.into()),
        ("status", "PASS".into()),
        ("missed", 0.into()),
        ("started", rig.report()["run"]["started"].clone()),
        ("bytes", bytes.into()),
        ("length_s", 0.051.into()),
    ] {
        assert_eq!(newest[key], value, "{key}");
    }
    let empty = rig.file("empty");
    fs::create_dir(&empty).unwrap();
    let none = rig.ok(&format!("runs --out {empty}")).stdout;
    assert_eq!(none, format!("{empty} holds no flight\n"));
    assert_eq!(rig.ok(&format!("runs --json --out {empty}")).stdout, "[]\n");
}

#[test]
fn pruning_removes_old_flights_with_all_their_files_and_keeps_the_newest() {
    let (rig, directories) = flown::<3>("pruned");
    let [old, middle, _] = directories.each_ref().map(|directory| name_of(directory));
    for format in ["csv", "json", "perfetto"] {
        rig.ok(&format!(
            "export {} --format {format}",
            directories[0].display()
        ));
    }
    rig.ok("runs --prune --keep 1 --dry-run")
        .says(&format!("would remove {old} ("))
        .says("2 flights, ")
        .says("would be removed");
    rig.ok("runs --prune --older-than 1h").says("0 flights, ");
    assert_eq!(exist(&directories), [true; 3]);
    rig.ok("runs --prune --keep 2")
        .says(&format!("removed {old} ("));
    assert_eq!(exist(&directories), [false, true, true]);
    rig.ok("runs --prune --keep 2")
        .says("0 flights, 0.0kB removed");
    rig.ok("runs --prune --older-than 0s")
        .says("`latest` points to it")
        .says(&format!("removed {middle} ("))
        .says("1 flight, ");
    assert_eq!(exist(&directories), [false, false, true]);
    rig.ok("runs").says("1 flight in ");
    rig.ok("report");
}

#[test]
fn flights_that_cannot_be_removed_are_named_and_the_others_are_removed() {
    let (rig, directories) = flown::<3>("resisting");
    let Some(prune) = unprivileged(&rig, "runs", "--prune --keep 1") else {
        return;
    };
    let allow =
        |path: &Path, mode| fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
    allow(&rig.out(), 0o777);
    allow(&directories[1], 0o777);
    allow(&directories[0], 0o555);
    let pruned = rig.launch(prune).end().expect(1);
    allow(&directories[0], 0o755);
    let [first, second, _] = directories.each_ref().map(|directory| name_of(directory));
    let path = directories[0].display();
    pruned
        .complains("1 flight could not be removed")
        .says(&format!("partly removed {first}: cannot remove {path}/"))
        .says(": Permission denied")
        .says(&format!("removed {second} ("))
        .says("1 flight, ");
    assert_eq!(exist(&directories), [true, false, true]);
}

#[test]
fn files_of_others_are_kept_with_their_directories() {
    let (rig, directories) = flown::<4>("foreign");
    fs::write(directories[0].join("notes.txt"), "mine").unwrap();
    fs::create_dir(directories[1].join("plots")).unwrap();
    fs::create_dir(directories[2].join("export")).unwrap();
    fs::write(directories[2].join("export/mine.csv"), "mine").unwrap();
    // A directory with the name of a flight, and a link to one elsewhere.
    let other = rig.out().join("2020-01-01T00-00-00Z");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("run.json"), "{\"name\": \"of another program\"}").unwrap();
    let elsewhere = rig.path("elsewhere");
    fs::rename(&directories[0], &elsewhere).unwrap();
    symlink(&elsewhere, &directories[0]).unwrap();
    let files = files_below(&rig.path("."));
    let pruned = rig.ok("runs --prune --keep 1");
    let pruned = pruned
        .says("0 flights, ")
        .says("/plots was not created by ironbird\n")
        .says("/export/mine.csv was not created by ironbird\n");
    let link = format!("{}:", name_of(&directories[0]));
    assert!(
        !pruned.stdout.contains(&link),
        "links are not followed: {pruned}"
    );
    assert_eq!(exist(&directories), [true; 4]);
    assert_eq!(files.iter().find(|path| !path.exists()), None);
}

#[test]
fn running_and_starting_flights_are_listed_and_kept() {
    let rig = Rig::new("aloft");
    let record = rig.start("record", "");
    wait_until("the directory of the flight", || {
        rig.run_directories().pop()
    });
    let out = rig.out().display().to_string();
    rig.ok(&format!("runs --out {out}")).says("starting");
    rig.ok(&format!("runs --prune --older-than 0s --out {out}"))
        .says("kept ")
        .says("0 flights");
    assert_eq!(rig.run_directories().len(), 1);
    record.signal(Signal::TERM);
    record.end().expect(130);
    let flight = rig.take_off(format!("--rt off --duration 1h --config {}", rig.slow(20)));
    wait_until("the flight to be listed", || {
        let listed = rig.run("runs", "--json").json();
        (listed[0]["status"] == "in the air" && listed[0]["is_latest"] == true).then_some(())
    });
    fs::remove_file(rig.out().join("latest")).unwrap();
    let pruned = rig.ok("runs --prune --older-than 0s --dry-run");
    pruned.says("its processes are running");
    flight.signal(Signal::INT);
    flight.end().expect(130);
    let listed = rig.ok("runs --json").json();
    assert_eq!(listed[0]["status"], "INTERRUPTED");
}

#[test]
fn flights_without_a_report_are_listed_and_removed() {
    let (rig, directories) = flown::<2>("reportless");
    let facts = directories[0].join("run.json");
    for path in files_below(&directories[0])
        .iter()
        .filter(|path| **path != facts)
    {
        fs::remove_file(path).unwrap();
    }
    let long_ago = SystemTime::now() - Duration::from_secs(100 * 86_400);
    let facts = File::options().write(true).open(facts).unwrap();
    facts.set_modified(long_ago).unwrap();
    rig.ok("runs").says("no report  -\n");
    let report = directories[0].join("report.json");
    fs::write(report, "{\"schema\": \"of another version\"}").unwrap();
    rig.ok("runs").says("unreadable  -\n");
    rig.ok("runs --prune --older-than 30d").says("1 flight, ");
    assert_eq!(exist(&directories), [false, true]);
}

#[test]
fn a_pipe_in_place_of_a_file_blocks_no_command() {
    let (rig, [whole]) = flown("pipes");
    let status = |file: &str| {
        let name = format!("with-a-pipe-for-{file}");
        let directory = rig.out().join(&name);
        fs::create_dir(&directory).unwrap();
        for copied in ["run.json", "report.json", "flight.mcap"] {
            if copied != file {
                fs::copy(whole.join(copied), directory.join(copied)).unwrap();
            }
        }
        let made = Command::new("mkfifo").arg(directory.join(file)).status();
        assert!(made.unwrap().success());
        let listed = rig.ok("runs --json").json();
        let mut runs = listed.as_array().unwrap().iter();
        let run = runs.find(|run| run["name"] == *name)?;
        Some(run["status"].as_str().unwrap().to_owned())
    };
    for (file, shown) in [
        ("run.json", None),
        ("report.json", Some("unreadable")),
        ("latency.hlog", Some("PASS")),
        ("flight.mcap", Some("PASS")),
    ] {
        assert_eq!(status(file).as_deref(), shown, "{file}");
    }
    rig.ok("runs --prune --keep 100");
    for command in ["export", "replay"] {
        let ended = rig.run(command, "with-a-pipe-for-flight.mcap");
        assert!(matches!(ended.code, Some(1 | 2)), "{ended}");
        ended.complains("is not a regular file");
    }
}
