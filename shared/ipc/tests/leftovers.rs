//! Leftovers: what a killed process leaves is found and removed, and nothing else.
//!
//! This is a test binary of its own, because locks of other threads live on for an instant when processes are started.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod common;
#[path = "leftovers/foreign.rs"]
mod foreign;

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::{Instance, SHARED_MEMORY};
use ipc::{Blackboard, BlackboardReader, DEEP, LATEST, SHEETS, Sender, SwapOrder, Wakes, Wire};
use messages::blackboards::ActiveParameters;
use messages::content::{RotorSpeeds, State};
use messages::header::Header;
use messages::role::Role;

use common::{EPOCH, EXPECTED, Site, remove, soon};

/// Segments in shared memory that belong to an instance.
fn segments(instance: &Instance) -> BTreeSet<PathBuf> {
    let prefix = format!("{SHARED_MEMORY}/{}", instance.prefix());
    files(Path::new(SHARED_MEMORY))
        .filter(|path| path.to_str().unwrap().starts_with(&prefix))
        .collect()
}

fn files(directory: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir(directory).unwrap();
    entries.filter_map(|entry| Some(entry.ok()?.path()))
}

fn create(wire: &Wire) -> Blackboard<ActiveParameters> {
    wire.blackboard("in_force").unwrap()
}

fn read(wire: &Wire) -> BlackboardReader<ActiveParameters> {
    wire.blackboard_reader("in_force").unwrap().unwrap()
}

fn put(board: &Blackboard<ActiveParameters>, tick: u64) {
    board.put(ActiveParameters {
        tick,
        ..ActiveParameters::default()
    });
}

fn sender(wire: &Wire) -> Sender<State> {
    let notifier = wire.notifier(Role::Outer).unwrap();
    let wakes = Wakes {
        receiver: Some(notifier),
        ..Wakes::default()
    };
    wire.sender(wakes).unwrap()
}

/// Ports of every kind, held until the value is dropped, with the lock of the plant.
fn hold_everything(instance: &Instance) -> impl Sized {
    instance.prepare().unwrap();
    let lock = instance.lock(Role::Plant).unwrap();
    let wire = Wire::open(instance).unwrap();
    let mut sender = sender(&wire);
    let receiver = wire.receiver::<RotorSpeeds>(LATEST).unwrap();
    let board = create(&wire);
    put(&board, 5);
    let server = wire.server::<SwapOrder>().unwrap();
    let event = wire.wake_event(Role::Plant).unwrap();
    sender.arm(EXPECTED, EPOCH).unwrap();
    (sender, receiver, board, server, event, wire, lock)
}

#[test]
fn removal_takes_exactly_what_the_instance_left_and_names_it() {
    let site = Site::new();
    // Names that begin alike, and one name under another root.
    let names = ["test-2", "test_2", "tes", "test2"];
    let beside = |name| Instance::under(site.root(), name).unwrap();
    let elsewhere = Site::new();
    let mut neighbours: Vec<Instance> = names.into_iter().map(beside).collect();
    neighbours.push(elsewhere.instance.clone());
    let theirs: Vec<_> = neighbours.iter().map(hold_everything).collect();
    let their_segments: Vec<_> = neighbours.iter().map(segments).collect();

    hold_everything_and_be_killed(&site.instance);
    let mut expected = segments(&site.instance);
    assert!(!expected.is_empty());
    expected.insert(site.instance.directory());
    let removed = site.instance.remove_leftovers().unwrap();
    assert_eq!(removed.iter().cloned().collect::<BTreeSet<_>>(), expected);
    assert!(removed.iter().all(|path| !path.exists()));
    assert!(site.instance.remove_leftovers().unwrap().is_empty());

    for (neighbour, had) in neighbours.iter().zip(&their_segments) {
        assert_eq!(&segments(neighbour), had, "{}", neighbour.name());
        assert!(neighbour.is_occupied(Role::Plant));
    }
    drop(theirs);
    neighbours.iter().for_each(remove);
}

/// Where the child process of a test finds its instance.
const CHILD_ROOT: &str = "IRONBIRD_TEST_CHILD_ROOT";

/// The child's part: holds everything until it is killed, or its parent is gone.
///
/// Run as a test of its own it has nothing to do.
#[test]
fn child_that_holds_everything_until_it_is_killed() {
    let Some(root) = std::env::var_os(CHILD_ROOT) else {
        return;
    };
    let instance = Instance::under(root.as_ref(), "test").unwrap();
    let _everything = hold_everything(&instance);
    println!("\nholding");
    let _ = std::io::stdin().read(&mut [0]);
}

/// What a process leaves that held everything of an instance when SIGKILL came: no destructor has run.
fn hold_everything_and_be_killed(instance: &Instance) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "child_that_holds_everything_until_it_is_killed",
            "--nocapture",
        ])
        .env(CHILD_ROOT, instance.directory().parent().unwrap())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // The child did not come so far.
    assert!(lines.map_while(Result::ok).any(|line| line == "holding"));
    assert!(instance.is_occupied(Role::Plant));
    child.kill().unwrap();
    // Until then it is a zombie, which counts as alive.
    child.wait().unwrap();
}

#[test]
fn the_place_of_a_killed_process_is_free_again() {
    let site = Site::new();
    // Survivors: a loop and a recorder that listened to the one that is killed, and an observer.
    let survivor = site.wire();
    let mut receiver = survivor.receiver::<State>(LATEST).unwrap();
    let mut recorder = survivor.receiver::<State>(DEEP).unwrap();
    let event = survivor.wake_event(Role::Outer).unwrap();
    hold_everything_and_be_killed(&site.instance);
    // The kernel has dropped its lock.
    assert!(!site.instance.is_occupied(Role::Plant));
    let _lock = soon(|| site.instance.lock(Role::Plant).ok()).unwrap();
    // The middleware still counts the dead one.
    assert!(survivor.sender::<State>(Wakes::default()).is_err());

    let wire = site.wire();
    assert_eq!(wire.cleaned, 1);
    assert_eq!(site.wire().cleaned, 0, "nothing is left for the next one");
    let mut sender = sender(&wire);
    let _commands = wire.receiver::<RotorSpeeds>(LATEST).unwrap();
    let _server = wire.server::<SwapOrder>().unwrap();
    let _event = wire.wake_event(Role::Plant).unwrap();
    let board = create(&wire);
    put(&board, 6);
    assert_eq!(read(&survivor).get().tick, 6);

    sender.arm(EXPECTED, EPOCH + 1).unwrap();
    receiver.arm(EXPECTED).unwrap();
    recorder.arm(EXPECTED).unwrap();
    for tick in 0..3 {
        sender.send(tick, &Header::new(), State::default()).unwrap();
        assert!(event.wait_until(now_ns() + 60_000_000_000).unwrap());
        // Survivors hear the one who took the place.
        assert_eq!(receiver.take(tick).unwrap(), tick);
    }
    let mut recorded = 0;
    recorder.drain(2, |_| recorded += 1).unwrap();
    assert_eq!(recorded, 3);
}

/// Makes the services of an instance what they are while they are being made: their files can be written.
fn put_back_into_the_making(instance: &Instance) {
    for file in files(&instance.directory().join("services")) {
        fs::set_permissions(file, fs::Permissions::from_mode(0o600)).unwrap();
    }
}

#[test]
fn a_service_that_its_maker_died_over_is_made_anew_beside_survivors() {
    let site = Site::new();
    // In the instance, with no share in any service.
    let survivor = site.wire();
    hold_everything_and_be_killed(&site.instance);
    put_back_into_the_making(&site.instance);
    let wire = site.wire();
    let _sender = wire.sender::<State>(Wakes::default()).unwrap();
    let _server = wire.server::<SwapOrder>().unwrap();
    let board = create(&wire);
    put(&board, 6);
    assert_eq!(read(&survivor).get().tick, 6);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_service_that_is_never_done_is_an_error_that_names_it() {
    let site = Site::new();
    let wire = site.wire();
    let (_sender, _board) = (
        wire.sender::<State>(Wakes::default()).unwrap(),
        create(&wire),
    );
    put_back_into_the_making(&site.instance);
    let other = site.wire();
    let topic = other.receiver::<State>(LATEST).map(drop);
    let board = other.blackboard::<ActiveParameters>("in_force").map(drop);
    for (opened, what) in [(topic, "topic `state`"), (board, "board `in_force`")] {
        let error = opened.unwrap_err();
        let words = format!(
            "cannot open {what}: another process has not created or removed it within 5 s: iceoryx2 says "
        );
        assert!(error.to_string().starts_with(&words), "{error}");
        assert_eq!(error.exit_code(), 1);
    }
    // Who only looks takes it for one that is not there yet.
    assert!(
        other
            .blackboard_reader::<ActiveParameters>("in_force")
            .unwrap()
            .is_none()
    );
}

#[test]
fn a_board_is_taken_over_from_killed_writers_while_an_observer_looks_at_it() {
    let site = Site::new();
    // Puts the blackboard up first, so that the observer holds it before the child writes.
    let observer = site.wire();
    let first = create(&observer);
    let reader = read(&observer);
    drop(first);
    for round in 10..10 + SHEETS - 1 {
        hold_everything_and_be_killed(&site.instance);
        assert_eq!(reader.get().tick, 5);
        let wire = site.wire();
        assert_eq!(wire.cleaned, 1);
        let board = create(&wire);
        assert_eq!(reader.get().tick, 5, "until its successor writes");
        for tick in [round, 1000 * round] {
            put(&board, tick);
            assert_eq!(reader.get().tick, tick);
            assert_eq!(read(&wire).get().tick, tick);
        }
        // Its successor may leave in order, and the one after that finds the blackboard as it was left.
        drop(board);
        let board = create(&wire);
        assert_eq!(reader.get().tick, 1000 * round);
        put(&board, 1);
        assert_eq!(reader.get().tick, 1);
    }
    // Its sheets are used up; the error is not one of another build, and the observer's leaving heals it.
    hold_everything_and_be_killed(&site.instance);
    let wire = site.wire();
    let error = wire
        .blackboard::<ActiveParameters>("in_force")
        .map(drop)
        .unwrap_err();
    assert!(matches!(error, Error::Wire { .. }), "{error}");
    drop((reader, observer));
    create(&wire);
}

#[test]
fn shared_memory_is_found_and_removed_also_when_somebody_has_removed_the_directory() {
    let site = Site::new();
    hold_everything_and_be_killed(&site.instance);
    let left = segments(&site.instance);
    fs::remove_dir_all(site.instance.directory()).unwrap();
    let set = |paths: Vec<PathBuf>| BTreeSet::from_iter(paths);
    assert_eq!(set(site.instance.leftovers()), left);
    assert!(!site.instance.directory().exists());
    assert_eq!(set(site.instance.remove_leftovers().unwrap()), left);
    assert_eq!(segments(&site.instance), BTreeSet::new());
    assert!(!site.instance.directory().exists());
}

#[test]
fn what_a_living_process_holds_is_never_cleaned() {
    let site = Site::new();
    let everything = hold_everything(&site.instance);
    let had = segments(&site.instance);
    assert_eq!(site.wire().cleaned, 0);
    assert_eq!(segments(&site.instance), had);
    assert!(site.instance.remove_leftovers().unwrap().is_empty());
    assert_eq!(segments(&site.instance), had);
    drop(everything);
}
