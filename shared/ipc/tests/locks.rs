//! Locks: one process per role, known by its process number, released when it dies.

use std::fs::{self, File};
use std::process::{self, Command};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use ipc::instance::Instance;
use messages::role::Role;
use rustix::fs::{FlockOperation, flock};

use crate::Site;

#[test]
fn a_role_has_one_process_which_the_error_names() {
    let site = Site::new();
    let instance = &site.instance;
    let pid = || instance.pid_of(Role::Plant);
    let is_free = || !instance.is_occupied(Role::Plant) && !instance.is_alive();
    instance.prepare().unwrap();
    assert!(is_free());
    let lock = instance.lock(Role::Plant).unwrap();
    let (us, words) = (process::id(), "instance `test` already has a running plant");
    let error = instance.lock(Role::Plant).unwrap_err();
    assert_eq!(error.exit_code(), 5);
    assert_eq!(error.to_string(), format!("{words} (process {us})"));
    assert!(instance.is_occupied(Role::Plant) && instance.is_alive());
    assert_eq!((pid(), instance.pid_of(Role::Mixer)), (Some(us), None));
    // A process that has not yet written its number has the role all the same.
    fs::write(instance.directory().join("plant.lock"), "").unwrap();
    assert_eq!(pid(), None);
    assert_eq!(instance.lock(Role::Plant).unwrap_err().to_string(), words);
    drop(lock);
    assert!(is_free());
    drop(instance.lock(Role::Plant).unwrap());
    assert_eq!(pid(), None, "the number in the file of a free lock");
}

#[test]
fn a_lock_that_outlives_its_process_is_said_to_be_another_ones() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    drop(site.instance.lock(Role::Inner).unwrap());
    let mut ended = Command::new("true").spawn().unwrap();
    ended.wait().unwrap();
    let path = site.instance.directory().join("inner.lock");
    fs::write(&path, format!("{}\n", ended.id())).unwrap();
    let kept = File::open(&path).unwrap();
    flock(&kept, FlockOperation::NonBlockingLockExclusive).unwrap();
    let error = site.instance.lock(Role::Inner).unwrap_err();
    let said = format!(
        "its inner (process {}) has ended, but a process that it left keeps its lock",
        ended.id()
    );
    assert!(error.to_string().contains(&said), "{error}");
    assert_eq!(error.exit_code(), 5);
    assert_eq!(
        error.remedy().unwrap(),
        format!("`fuser -v {}` names it: end it", path.display())
    );
}

#[test]
fn looking_whether_a_role_is_taken_never_keeps_a_process_from_taking_it() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    let done = AtomicBool::new(false);
    let refused = thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    let _ = site.instance.is_occupied(Role::Outer);
                    // Far more often than anybody looks, but not without a break.
                    thread::sleep(Duration::from_micros(100));
                }
            });
        }
        let refused = (0..2000).find_map(|_| site.instance.lock(Role::Outer).err());
        done.store(true, Ordering::Relaxed);
        refused
    });
    assert!(refused.is_none(), "{}", refused.unwrap());
}

#[test]
fn a_root_path_has_many_spellings_and_one_instance() {
    let site = Site::new();
    let link = site.root().join("link");
    std::os::unix::fs::symlink(site.root(), &link).unwrap();
    let root = site.root().to_str().unwrap();
    for spelling in [
        format!("{root}/"),
        format!("/tmp/../{root}"),
        format!("{root}/."),
        link.to_str().unwrap().into(),
    ] {
        let other = Instance::under(spelling.as_ref(), "test").unwrap();
        assert_eq!(other.directory(), site.instance.directory(), "{spelling}");
        assert_eq!(other.prefix(), site.instance.prefix(), "{spelling}");
    }
    let missing = site.root().join("none/../a");
    assert!(Instance::under(&missing, "test").is_err());
    // Also one that is made later.
    let later = |spelling: &str| Instance::under(&site.root().join(spelling), "test").unwrap();
    let (one, other) = (later("a/b"), later("link/a//b/"));
    one.prepare().unwrap();
    let _lock = other.lock(Role::Plant).unwrap();
    assert!(one.is_occupied(Role::Plant));
    assert_eq!(
        (one.prefix(), later("a/b/../b").prefix()),
        (other.prefix(), other.prefix())
    );
}

#[test]
fn a_lock_that_was_taken_is_held_also_while_leftovers_are_removed() {
    let site = Site::new();
    let done = AtomicBool::new(false);
    let lost = thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    site.instance.remove_leftovers().unwrap();
                }
            });
        }
        let lost = (0..1000).find_map(|round| {
            // A directory that goes in this instant is made again.
            let lock = match site
                .instance
                .prepare()
                .and_then(|()| site.instance.lock(Role::Inner))
            {
                Ok(lock) => lock,
                Err(e) => return Some(format!("round {round}: {e}")),
            };
            let is_seen = site.instance.is_occupied(Role::Inner);
            drop(lock);
            (!is_seen).then(|| format!("round {round}: the lock is held, and the role is free"))
        });
        done.store(true, Ordering::Relaxed);
        lost
    });
    assert_eq!(lost, None);
}
