//! Leftovers: what a killed process leaves is found and removed, and nothing else.
//!
//! This is a test binary of its own, because locks of other threads live on for an instant when processes are started.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod common;

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::{chown, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use model::boards::InForce;
use model::envelope::Envelope;
use model::messages::{RotorSpeeds, State};
use model::role::Role;
use wire::clock::now_ns;
use wire::error::Error;
use wire::instance::{Instance, SHARED_MEMORY};
use wire::{DEEP, LATEST, Wire};

use common::{EPOCH, EXPECTED, Site, remove, soon};

/// A user who owns nothing.
const NOBODY: u32 = 65534;

/// Segments in shared memory that belong to an instance.
fn segments(instance: &Instance) -> BTreeSet<PathBuf> {
    fs::read_dir(SHARED_MEMORY)
        .unwrap()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(&instance.prefix()))
        .collect()
}

/// Ports of every kind, held until the value is dropped, with the lock of the plant.
fn hold_everything(instance: &Instance) -> impl Sized {
    instance.prepare().unwrap();
    let lock = instance.lock(Role::Plant).unwrap();
    let wire = Wire::open(instance).unwrap();
    let mut sender = wire.sender::<State>(Some(wire.bell(Role::Outer).unwrap())).unwrap();
    let receiver = wire.receiver::<RotorSpeeds>(LATEST).unwrap();
    let board = wire.board::<InForce>("in_force").unwrap();
    board.put(InForce { tick: 5, ..InForce::default() });
    let (server, doorbell) = (wire.swap_server().unwrap(), wire.doorbell(Role::Plant).unwrap());
    sender.arm(EXPECTED, EPOCH).unwrap();
    (sender, receiver, board, server, doorbell, wire, lock)
}

#[test]
fn an_instance_that_ended_in_order_leaves_no_segment() {
    let site = Site::new();
    let everything = hold_everything(&site.instance);
    assert!(segments(&site.instance).len() >= 3, "{:?}", segments(&site.instance));
    drop(everything);
    let left = segments(&site.instance);
    assert!(left.iter().all(|path| path.extension().is_some_and(|e| e == "global_mgmt")), "{left:?}");
}

#[test]
fn removal_takes_exactly_what_the_instance_left_and_names_it() {
    let site = Site::new();
    // Names that begin alike, and one name under another root.
    let neighbours: Vec<Instance> =
        ["test-2", "tes", "test2"].iter().map(|name| Instance::under(site.root(), name).unwrap()).collect();
    let elsewhere = Site::new();
    let theirs: Vec<_> = neighbours.iter().chain([&elsewhere.instance]).map(hold_everything).collect();
    let their_segments: Vec<_> = neighbours.iter().chain([&elsewhere.instance]).map(segments).collect();

    hold_everything_and_be_killed(&site.instance);
    let mut expected = segments(&site.instance);
    assert!(!expected.is_empty());
    expected.insert(site.instance.directory());
    let removed = site.instance.remove_leftovers().unwrap();
    assert_eq!(removed.iter().cloned().collect::<BTreeSet<_>>(), expected);
    assert!(removed.iter().all(|path| !path.exists()));
    assert_eq!(site.instance.remove_leftovers().unwrap(), Vec::<PathBuf>::new(), "nothing is left to remove");

    for (neighbour, had) in neighbours.iter().chain([&elsewhere.instance]).zip(&their_segments) {
        assert_eq!(&segments(neighbour), had, "{}", neighbour.name());
        assert!(neighbour.is_occupied(Role::Plant));
    }
    drop(theirs);
    for neighbour in &neighbours {
        remove(neighbour);
    }
}

#[test]
fn removal_spares_an_instance_whose_name_continues_after_an_underscore() {
    let site = Site::new();
    let neighbour = Instance::under(site.root(), "test_2").unwrap();
    let theirs = hold_everything(&neighbour);
    let had = segments(&neighbour);
    site.instance.prepare().unwrap();
    let removed = site.instance.remove_leftovers().unwrap();
    let has = segments(&neighbour);
    drop(theirs);
    remove(&neighbour);
    assert_eq!(removed, [site.instance.directory()]);
    assert_eq!(has, had);
}

/// Where the child process of a test finds its instance.
const CHILD_ROOT: &str = "IRONBIRD_TEST_CHILD_ROOT";

/// The child's part: holds everything until it is killed, or its parent is gone.
///
/// Run as a test of its own it has nothing to do.
#[test]
fn child_that_holds_everything_until_it_is_killed() {
    let Some(root) = std::env::var_os(CHILD_ROOT) else { return };
    let instance = Instance::under(root.as_ref(), "test").unwrap();
    let _everything = hold_everything(&instance);
    println!("\nholding");
    let _ = std::io::stdin().read(&mut [0]);
}

/// What a process leaves that held everything of an instance when SIGKILL came: no destructor has run.
fn hold_everything_and_be_killed(instance: &Instance) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child_that_holds_everything_until_it_is_killed", "--nocapture"])
        .env(CHILD_ROOT, instance.directory().parent().unwrap())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.map_while(Result::ok).any(|line| line == "holding"), "the child did not come so far");
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
    let doorbell = survivor.doorbell(Role::Outer).unwrap();
    hold_everything_and_be_killed(&site.instance);
    assert!(!site.instance.is_occupied(Role::Plant), "the kernel has dropped its lock");
    let _lock = soon(|| site.instance.lock(Role::Plant).ok()).unwrap();
    assert!(survivor.sender::<State>(None).is_err(), "the middleware still counts the dead one");

    let wire = site.wire();
    assert_eq!(wire.cleaned, 1);
    assert_eq!(site.wire().cleaned, 0, "nothing is left for the next one");
    let mut sender = wire.sender::<State>(Some(wire.bell(Role::Outer).unwrap())).unwrap();
    let _commands = wire.receiver::<RotorSpeeds>(LATEST).unwrap();
    let _server = wire.swap_server().unwrap();
    let _doorbell = wire.doorbell(Role::Plant).unwrap();
    let board = wire.board::<InForce>("in_force").unwrap();
    board.put(InForce { tick: 6, ..InForce::default() });
    assert_eq!(survivor.board_reader::<InForce>("in_force").unwrap().unwrap().get().tick, 6);

    sender.arm(EXPECTED, EPOCH + 1).unwrap();
    receiver.arm(EXPECTED).unwrap();
    recorder.arm(EXPECTED).unwrap();
    for tick in 0..3 {
        sender.send(tick, &Envelope::new(), State::default()).unwrap();
        assert!(doorbell.wait_until(now_ns() + 60_000_000_000).unwrap());
        assert_eq!(receiver.take(tick).unwrap(), tick, "survivors hear the one who took the place");
    }
    let mut recorded = 0;
    recorder.drain(2, |_| recorded += 1).unwrap();
    assert_eq!(recorded, 3);
}

#[test]
fn a_board_is_taken_over_from_killed_writers_while_an_observer_looks_at_it() {
    let site = Site::new();
    // Puts the board up first, so that the observer holds it before the child writes.
    let observer = site.wire();
    let first = observer.board::<InForce>("in_force").unwrap();
    let reader = observer.board_reader::<InForce>("in_force").unwrap().unwrap();
    drop(first);
    for round in 10..17 {
        hold_everything_and_be_killed(&site.instance);
        assert_eq!(reader.get().tick, 5, "what the killed one wrote last, in round {round}");
        let wire = site.wire();
        assert_eq!(wire.cleaned, 1);
        let board = wire.board::<InForce>("in_force").unwrap();
        assert_eq!(reader.get().tick, 5, "until its successor writes");
        for tick in [round, 1000 * round] {
            board.put(InForce { tick, ..InForce::default() });
            assert_eq!(reader.get().tick, tick);
            assert_eq!(wire.board_reader::<InForce>("in_force").unwrap().unwrap().get().tick, tick);
        }
        // Its successor may leave in order, and the one after that finds the board as it was left.
        drop(board);
        let board = wire.board::<InForce>("in_force").unwrap();
        assert_eq!(reader.get().tick, 1000 * round);
        board.put(InForce { tick: 1, ..InForce::default() });
        assert_eq!(reader.get().tick, 1);
    }
    // Its sheets are used up; the error is not one of another build, and the observer's leaving heals it.
    hold_everything_and_be_killed(&site.instance);
    let wire = site.wire();
    let error = wire.board::<InForce>("in_force").map(drop).unwrap_err();
    assert!(matches!(error, Error::Wire { .. }), "{error}");
    drop((reader, observer));
    wire.board::<InForce>("in_force").unwrap();
}

#[test]
fn what_a_living_process_holds_is_never_cleaned() {
    let site = Site::new();
    let everything = hold_everything(&site.instance);
    let had = segments(&site.instance);
    assert_eq!(site.wire().cleaned, 0);
    assert_eq!(segments(&site.instance), had);
    assert_eq!(site.instance.remove_leftovers().unwrap(), Vec::<PathBuf>::new());
    assert_eq!(segments(&site.instance), had);
    drop(everything);
}

/// Puts things into a directory that somebody may have there: a tree, a file, a socket, a pipe, links.
fn furnish(directory: &Path) {
    fs::create_dir_all(directory.join("src/deep")).unwrap();
    fs::write(directory.join("src/deep/main.c"), "int main;").unwrap();
    fs::write(directory.join("notes"), "mine").unwrap();
    symlink(directory.join("src"), directory.join("link")).unwrap();
    symlink("/nowhere", directory.join("dangling")).unwrap();
    UnixListener::bind(directory.join("bus")).unwrap();
}

/// Everything below a directory, links not followed.
fn everything_below(directory: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(directory).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_dir() {
            found.append(&mut everything_below(&entry.path()));
        }
        found.insert(entry.path());
    }
    found
}

#[test]
fn a_directory_that_somebody_else_has_made_is_neither_used_nor_removed() {
    let site = Site::new();
    let home = site.root().join("home");
    fs::create_dir(&home).unwrap();
    furnish(&home);
    furnish(&home.join("src"));
    fs::write(home.join("src/plant.lock"), "").unwrap();
    let had = everything_below(&home);
    for (name, words) in [
        ("src", "home/src is no directory of ironbird: in it lie `bus`, `dangling`, `deep` and 3 more"),
        ("notes", "home/notes is not used: it is no directory"),
        ("bus", "home/bus is not used: it is no directory"),
        ("link", "home/link is not used: it is a symbolic link"),
        ("dangling", "home/dangling is not used: it is a symbolic link"),
    ] {
        let instance = Instance::under(&home, name).unwrap();
        assert_eq!(instance.remove_leftovers().unwrap(), Vec::<PathBuf>::new(), "{name}");
        assert_eq!(instance.leftovers(), Vec::<PathBuf>::new(), "{name}");
        assert_eq!(everything_below(&home), had, "{name}");
        for error in [
            instance.prepare().unwrap_err(),
            instance.lock(Role::Plant).map(drop).unwrap_err(),
            Wire::open(&instance).map(drop).unwrap_err(),
        ] {
            assert!(error.to_string().ends_with(words), "{name}: {error}");
            assert_eq!(error.exit_code(), 2, "{name}");
            assert!(error.remedy().unwrap().contains("IRONBIRD_ROOT"), "{name}");
        }
        assert_eq!(everything_below(&home), had, "{name}");
    }
    // One that is empty belongs to nobody.
    fs::create_dir(home.join("empty")).unwrap();
    let empty = Instance::under(&home, "empty").unwrap();
    assert_eq!(empty.remove_leftovers().unwrap(), Vec::<PathBuf>::new());
    assert!(home.join("empty").exists(), "nobody has used it");
    empty.prepare().unwrap();
    assert_eq!(empty.remove_leftovers().unwrap(), [home.join("empty")]);
    assert_eq!(everything_below(&home), had);
}

#[test]
fn what_is_foreign_in_an_instances_directory_stays_and_is_named() {
    let site = Site::new();
    let instance = &site.instance;
    hold_everything_and_be_killed(instance);
    let directory = instance.directory();
    let ours = everything_below(&directory);
    let node = ours.iter().find(|path| path.is_dir() && path.parent() == Some(&directory.join("nodes"))).unwrap();
    let mut foreign = BTreeSet::new();
    for place in [&directory, &directory.join("services"), &directory.join("nodes"), node] {
        furnish(place);
        foreign.extend(["src", "notes", "link", "dangling", "bus"].map(|name| place.join(name)));
        // Under names that we give to files.
        for name in ["inner.lock".to_owned(), format!("{}x.service", instance.prefix())] {
            symlink("/nowhere", place.join(&name)).unwrap();
            foreign.insert(place.join(name));
        }
    }
    let kept = everything_below(&directory).difference(&ours).cloned().collect::<BTreeSet<_>>();

    let announced = instance.leftovers();
    assert_eq!(instance.foreign().into_iter().collect::<BTreeSet<_>>(), foreign);
    let removed = instance.remove_leftovers().unwrap();
    assert_eq!(announced, removed);
    assert!(removed.iter().all(|path| !path.exists()), "{removed:?}");
    assert_eq!(segments(instance), BTreeSet::new());
    let places = BTreeSet::from([directory.join("services"), directory.join("nodes"), node.clone()]);
    let left: BTreeSet<_> = everything_below(&directory).difference(&places).cloned().collect();
    assert!(left.iter().filter(|path| !kept.contains(*path)).eq([&directory.join(".ironbird")]), "{left:?}");
    assert!(kept.is_subset(&left), "{left:?}");
    // It is still ours: an instance flies in it, and it goes with the last thing that is foreign.
    drop(hold_everything(instance));
    fs::remove_dir_all(directory.join("services")).unwrap();
    fs::remove_dir_all(directory.join("nodes")).unwrap();
    for path in foreign.iter().filter(|path| path.parent() == Some(&directory)) {
        if path.ends_with("src") { fs::remove_dir_all(path).unwrap() } else { fs::remove_file(path).unwrap() }
    }
    assert_eq!(instance.foreign(), Vec::<PathBuf>::new());
    assert!(instance.remove_leftovers().unwrap().contains(&directory));
    assert!(!directory.exists());
}

#[test]
fn shared_memory_is_found_and_removed_also_when_somebody_has_removed_the_directory() {
    let site = Site::new();
    hold_everything_and_be_killed(&site.instance);
    let left = segments(&site.instance);
    fs::remove_dir_all(site.instance.directory()).unwrap();
    assert_eq!(site.instance.leftovers().into_iter().collect::<BTreeSet<_>>(), left);
    assert!(!site.instance.directory().exists());
    assert_eq!(site.instance.remove_leftovers().unwrap().into_iter().collect::<BTreeSet<_>>(), left);
    assert_eq!(segments(&site.instance), BTreeSet::new());
    assert!(!site.instance.directory().exists());
}

#[test]
fn in_shared_memory_only_files_of_this_user_are_removed() {
    let site = Site::new();
    hold_everything_and_be_killed(&site.instance);
    let ours = segments(&site.instance);
    let name = |what: &str| Path::new(SHARED_MEMORY).join(format!("{}{what}", site.instance.prefix()));
    symlink("/nowhere", name("link")).unwrap();
    fs::create_dir(name("directory")).unwrap();
    fs::write(name("file"), "of nobody").unwrap();
    let is_nobodys = chown(name("file"), Some(NOBODY), Some(NOBODY)).is_ok();
    if !is_nobodys {
        writeln!(std::io::stderr().lock(), "skipped in part: only root makes a file of another user").unwrap();
    }
    let removed: BTreeSet<_> = site.instance.remove_leftovers().unwrap().into_iter().collect();
    let kept = [name("link"), name("directory"), name("file")].map(|path| path.symlink_metadata().is_ok());
    let refused = Wire::open(&site.instance).map(drop);
    fs::remove_file(name("link")).unwrap();
    fs::remove_dir(name("directory")).unwrap();
    let _ = fs::remove_file(name("file"));
    assert!(ours.is_subset(&removed) && ours.iter().all(|path| !path.exists()), "{removed:?}");
    assert_eq!(kept, [true, true, is_nobodys]);
    let error = refused.unwrap_err();
    assert!(error.to_string().contains("it has a name of this instance, and is no file of this user"), "{error}");
    drop(site.wire());
}
