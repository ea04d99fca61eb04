//! The directories of an instance and of flights, and the link `latest`.

use crate::endings::kill_all;
use crate::rig::unprivileged::unprivileged;
use crate::rig::{Ended, Rig, Running, not_tested, wait_until};
use flight_log::entry::LogEntry;
use flight_log::facts::{Facts, LogPlan, record};
use flight_log::writer::FlightLog;
use ipc::instance::Instance;
use ironbird::run_directory::RunDirectory;
use ironbird::settings::Settings;
use messages::content::State;
use messages::grid::Pace;
use messages::header::{Header, Message};
use messages::role::Role;
use messages::telemetry::Signals;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

const NOBODY: u32 = 65534;

/// Makes the root what a home directory is: trees, files, a socket and links, under names that instances may have.
fn furnish(home: &Path) {
    for tree in ["src/deep", "work", "go/pkg"] {
        fs::create_dir_all(home.join(tree)).unwrap();
    }
    fs::write(home.join("src/deep/main.c"), "int main;").unwrap();
    fs::write(home.join("work/thesis"), "mine").unwrap();
    fs::write(home.join("notes"), "mine").unwrap();
    symlink(home.join("src"), home.join("link")).unwrap();
    UnixListener::bind(home.join("bus")).unwrap();
}

/// Everything below a directory with what is in it, links not followed.
fn everything_below(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(directory).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_dir() {
            found.append(&mut everything_below(&entry.path()));
        }
        let is_file = entry.file_type().unwrap().is_file();
        found.insert(
            entry.path(),
            if is_file {
                fs::read(entry.path()).unwrap()
            } else {
                Vec::new()
            },
        );
    }
    found
}

fn short_flight(rig: &Rig, more: &str) -> Ended {
    let slow = rig.slow(5);
    rig.run(
        "fly",
        format!("--rt off --config {slow} --duration 100ms {more}"),
    )
}

#[test]
fn clean_takes_what_is_ours_from_a_root_that_is_a_home_directory_and_nothing_else() {
    let rig = Rig::new("homely");
    fs::create_dir(rig.root()).unwrap();
    furnish(&rig.root());
    let had = everything_below(&rig.root());
    rig.ok("clean").says("nothing to remove");
    assert_eq!(everything_below(&rig.root()), had);

    kill_all(rig.take_off(format!("--rt off --config {}", rig.slow(1000))));
    let left = everything_below(&rig.root());
    let segments = rig.segments();
    assert!(!segments.is_empty() && left.len() > had.len());
    let directory = rig.known().directory();
    let announced = rig
        .ok("clean --dry-run")
        .says(&format!("would remove {}\n", directory.display()));
    let announced = segments.iter().fold(announced, |said, name| {
        said.says(&format!("would remove /dev/shm/{name}\n"))
    });
    assert_eq!(
        (everything_below(&rig.root()), rig.segments()),
        (left, segments),
        "nothing is removed"
    );
    let removed = rig.ok("clean");
    assert_eq!(
        removed.stdout,
        announced.stdout.replace("would remove", "removed")
    );
    assert_eq!(everything_below(&rig.root()), had);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_leaves_a_home_directory_as_it_was() {
    let rig = Rig::new("guest");
    fs::create_dir(rig.root()).unwrap();
    furnish(&rig.root());
    let had = everything_below(&rig.root());
    for (name, words) in [
        ("work", "is no directory of ironbird: in it lies `thesis`"),
        ("notes", "it is no directory"),
    ] {
        for command in ["fly", "plant", "record"] {
            rig.run(command, format!("--instance {name} --rt off"))
                .expect(2)
                .complains(words);
            assert_eq!(
                everything_below(&rig.root()),
                had,
                "{command} --instance {name}"
            );
        }
    }
    assert!(
        rig.run_directories().is_empty(),
        "{:?}",
        rig.run_directories()
    );
    short_flight(&rig, "").expect(0);
    assert_eq!(everything_below(&rig.root()), had);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn what_is_put_into_the_directory_during_a_flight_stays_and_clean_names_it() {
    let rig = Rig::new("foreign");
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 100ms",
        rig.slow(20)
    ));
    let directory = rig.known().directory();
    furnish(&directory);
    flight.end().expect(0);
    let left = everything_below(&directory);
    assert_eq!(left[&directory.join("work/thesis")], b"mine");
    assert_eq!(rig.segments(), Vec::<String>::new());
    let named = rig.ok("clean");
    for name in ["bus", "go", "link", "notes", "src", "work"] {
        assert!(
            named.stdout.contains(&format!(
                "kept {}: not created by ironbird\n",
                directory.join(name).display()
            )),
            "{named}"
        );
    }
    assert_eq!(everything_below(&directory), left);
    // It is still the instance's.
    short_flight(&rig, "").expect(0);
    assert_eq!(everything_below(&directory), left);
}

/// `ironbird COMMAND` in a directory of its own, with a root path that is relative to it.
fn in_directory(rig: &Rig, directory: &Path, command: &str, args: &str) -> Running {
    fs::create_dir_all(directory).unwrap();
    let mut process = rig.command_by(&["env", "-C", directory.to_str().unwrap()], command, args);
    process.env("IRONBIRD_ROOT", "rig");
    rig.launch(process)
}

#[test]
#[ignore = "long: part of the gate"]
fn one_relative_root_in_two_directories_is_two_roots() {
    let rig = Rig::new("relative");
    let (one, other) = (rig.path("a"), rig.path("b"));
    let slow = rig.slow(20);
    // So long that it lives until it is told to end.
    let args = format!("--rt off --config {slow} --duration 30s");
    let flight = in_directory(&rig, &one, "fly", &args);
    let known = Instance::under(&one.join("rig"), &rig.instance).unwrap();
    let segments = || {
        rig.segments()
            .into_iter()
            .filter(|name| name.starts_with(&known.prefix()))
            .count()
    };
    wait_until("the plant to have its place", || {
        known.is_occupied(Role::Plant).then_some(())
    });
    wait_until("shared memory", || (segments() > 0).then_some(()));
    let args = format!("--rt off --config {} --duration 50ms", rig.slow(5));
    in_directory(&rig, &other, "fly", &args).end().expect(0);
    in_directory(&rig, &other, "clean", "").end().expect(0);
    let left = segments();
    flight.signal(Signal::INT);
    flight.end().expect(130);
    assert!(
        left > 0,
        "the end of one flight removed the memory of the other"
    );
    rig.assert_nothing_left();
}

#[test]
fn without_a_root_path_the_session_has_it_if_it_is_this_users_or_else_tmp() {
    let rig = Rig::new("default");
    let user = rustix::process::geteuid().as_raw();
    let session = rig.path("run");
    fs::create_dir(&session).unwrap();
    let place_of_plant = |root: PathBuf| {
        let mut command = rig.command("plant", "--rt off");
        command
            .env_remove("IRONBIRD_ROOT")
            .env("XDG_RUNTIME_DIR", &session);
        let plant = rig.launch(command);
        plant.await_words("waiting for");
        let lock = root.join(&rig.instance).join("plant.lock");
        assert_eq!(
            fs::read_to_string(&lock).unwrap().trim(),
            plant.pid().to_string()
        );
        assert_eq!(root.metadata().unwrap().mode() & 0o022, 0);
        plant.signal(Signal::TERM);
        plant.end().expect(130);
        assert!(!lock.exists());
    };
    place_of_plant(session.join("ironbird"));
    if chown(&session, Some(NOBODY), Some(NOBODY)).is_err() {
        not_tested("the root path without XDG_RUNTIME_DIR: only root gives a directory away");
        return;
    }
    place_of_plant(PathBuf::from(format!("/tmp/ironbird-{user}")));
    assert!(
        fs::read_dir(session.join("ironbird"))
            .unwrap()
            .next()
            .is_none()
    );
}

#[test]
fn a_flight_that_cannot_be_looked_at_is_not_said_to_be_none() {
    let rig = Rig::new("hidden");
    let instance = rig.known();
    instance.prepare().unwrap();
    let lock = instance.lock(Role::Plant).unwrap();
    fs::create_dir(instance.directory().join("in_use.lock")).unwrap();
    for args in [["params", "--json"], ["inject", "mass_kg=0.5"]] {
        let ended = rig
            .run(args[0], &args[1..])
            .expect(2)
            .complains("/in_use.lock: Is a directory");
        assert!(!ended.stderr.contains("start one"), "{ended}");
    }
    fs::remove_dir(instance.directory().join("in_use.lock")).unwrap();

    // Somebody who may not look.
    if !rustix::process::geteuid().is_root() {
        return not_tested("a flight of another user: this user may not become one");
    }
    for args in [["params", "--json"], ["inject", "mass_kg=0.5"]] {
        let Some(command) = unprivileged(&rig, args[0], &args[1..]) else {
            return;
        };
        fs::set_permissions(rig.root(), fs::Permissions::from_mode(0o755)).unwrap();
        let ended = rig
            .launch(command)
            .end()
            .expect(2)
            .complains("/plant.lock: Permission denied");
        assert!(!ended.stderr.contains("start one"), "{ended}");
    }
    drop(lock);
}

#[test]
fn a_flights_directory_goes_unless_something_was_recorded() {
    let rig = Rig::new("discarded");
    let settings = Settings::resolve(None, &Vec::new()).unwrap();
    let (plan, records) = (LogPlan::WHOLE, vec![("run", record(&[]))]);
    let (signals, no_theorem) = (Signals::default(), None);
    let facts = Facts {
        pace: Pace::Lockstep,
        sample_time_ns: 1_000_000,
        plan,
        signals,
        no_theorem,
        records,
    };
    for (messages, kept) in [(0, false), (1, true)] {
        let directory = RunDirectory::create(&rig.out(), &settings, "some").unwrap();
        for name in ["record.log", "plant.log", "latency.hlog", "states.csv"] {
            fs::write(directory.path.join(name), "what a recorder has begun\n").unwrap();
        }
        let mut log = FlightLog::create(&directory.path.join("flight.mcap"), &facts).unwrap();
        (0..messages).for_each(|_| {
            log.take(LogEntry::State(Message {
                envelope: Header::new(),
                content: State::default(),
            }))
        });
        log.finish(record(&[])).unwrap();
        directory.discard();
        assert_eq!(directory.path.exists(), kept, "{messages} messages");
    }
    let empty = RunDirectory::create(&rig.out(), &settings, "some").unwrap();
    fs::write(empty.path.join("flight.mcap"), "").unwrap();
    empty.discard();
    assert!(
        !empty.path.exists(),
        "a recorder that was killed before its first chunk leaves an empty log"
    );
}

#[test]
fn latest_stays_where_it_was_until_a_flight_has_a_report() {
    let rig = Rig::new("latest");
    let latest = || fs::read_link(rig.out().join("latest")).unwrap();
    rig.run("fly", "--rt off --duration 100ms");
    let flown = latest();
    assert_eq!(rig.run_directories(), [flown.to_str().unwrap()]);
    // Without a plant to fly with: it waits.
    let recorder = rig.start("record", "--rt off");
    recorder.await_words("waiting for");
    assert_eq!((latest(), rig.run_directories().len()), (flown.clone(), 2));
    recorder.signal(Signal::TERM);
    recorder.end().expect(130);
    assert_eq!(
        (latest(), rig.run_directories().len()),
        (flown.clone(), 1),
        "an empty directory is removed"
    );
    let flight = rig.take_off("--rt off --duration 600s");
    wait_until("the first report", || (latest() != flown).then_some(()));
    assert!(rig.out().join("latest/report.json").exists());
    flight.signal(Signal::INT);
    flight.end().expect(130);
}

#[test]
fn a_directory_called_latest_stays_and_the_report_says_so() {
    let rig = Rig::new("no-link");
    let directory = rig.out().join("latest");
    fs::create_dir_all(&directory).unwrap();
    let words = format!(
        "latest is incomplete: cannot point to the flight with {}: Is a direct",
        directory.display()
    );
    rig.ok("fly --pace lockstep --duration 100ms")
        .tells(&format!("INCOMPLETE RECORD: {words}"));
    assert!(fs::symlink_metadata(&directory).unwrap().is_dir() && rig.run_directories().len() == 1);
    let left = fs::read_dir(rig.out()).unwrap().count();
    assert_eq!(left, 2, "a draft of the link is left");
}
