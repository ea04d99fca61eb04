//! Locks: one process per role, known by its process number, released when it dies.

use std::fs::File;
use std::process::Command;

use ::ipc::error::Error;
use ::ipc::instance::Instance;
use messages::role::{ROLES, Role};
use rustix::fs::{FlockOperation, flock};

use crate::Site;

#[test]
fn the_second_to_lock_a_role_is_told_who_has_it() {
    let site = Site::new();
    let instance = &site.instance;
    instance.prepare().unwrap();
    assert!(!instance.is_occupied(Role::Plant) && !instance.is_alive());
    let lock = instance.lock(Role::Plant).unwrap();
    let error = instance.lock(Role::Plant).unwrap_err();
    assert_eq!(error.exit_code(), 5);
    match error {
        Error::Occupied {
            instance,
            role,
            pid,
        } => {
            assert_eq!((instance.as_str(), role.as_str()), ("test", "plant"));
            assert_eq!(pid, Some(std::process::id()));
        }
        other => panic!("{other}"),
    }
    assert!(instance.is_occupied(Role::Plant) && instance.is_alive());
    assert_eq!(
        (instance.pid_of(Role::Plant), instance.pid_of(Role::Mixer)),
        (Some(std::process::id()), None)
    );
    drop(lock);
    assert!(!instance.is_occupied(Role::Plant) && !instance.is_alive());
    assert_eq!(
        instance.pid_of(Role::Plant),
        None,
        "the number that is left in the file is nobody's"
    );
    instance.lock(Role::Plant).unwrap();
}

#[test]
fn a_role_whose_process_has_not_yet_written_its_number_is_taken_all_the_same() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    let _lock = site.instance.lock(Role::Plant).unwrap();
    std::fs::write(site.instance.directory().join("plant.lock"), "").unwrap();
    assert_eq!(site.instance.pid_of(Role::Plant), None);
    let error = site.instance.lock(Role::Plant).unwrap_err();
    assert_eq!(
        error.to_string(),
        "instance `test` already has a running plant"
    );
}

#[test]
fn a_lock_that_outlives_its_process_is_said_to_be_another_ones() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    drop(site.instance.lock(Role::Inner).unwrap());
    let mut ended = Command::new("true").spawn().unwrap();
    ended.wait().unwrap();
    let path = site.instance.directory().join("inner.lock");
    std::fs::write(&path, format!("{}\n", ended.id())).unwrap();
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
fn roles_instances_and_the_launcher_lock_side_by_side() {
    let site = Site::new();
    let other = Instance::under(site.root(), "other").unwrap();
    site.instance.prepare().unwrap();
    other.prepare().unwrap();
    let locks: Vec<_> = ROLES
        .iter()
        .map(|role| site.instance.lock(*role).unwrap())
        .collect();
    assert!(!other.is_alive());
    other.lock(Role::Plant).unwrap();
    let launcher = site.instance.lock_launcher().unwrap();
    let error = site.instance.lock_launcher().unwrap_err();
    assert!(
        error.to_string().contains("already has a running fly"),
        "{error}"
    );
    drop(locks);
    assert!(site.instance.is_alive(), "the launcher alone");
    drop(launcher);
    assert!(!site.instance.is_alive());
}

#[test]
fn a_lock_survives_the_removal_of_leftovers() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    let _lock = site.instance.lock(Role::Mixer).unwrap();
    assert_eq!(
        site.instance.remove_leftovers().unwrap(),
        Vec::<std::path::PathBuf>::new(),
        "it is alive"
    );
    assert!(site.instance.is_occupied(Role::Mixer));
    assert!(site.instance.lock(Role::Mixer).is_err());
}

#[test]
fn looking_whether_a_role_is_taken_never_keeps_a_process_from_taking_it() {
    let site = Site::new();
    site.instance.prepare().unwrap();
    let done = std::sync::atomic::AtomicBool::new(false);
    let refused = std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    let _ = site.instance.is_occupied(Role::Outer);
                    // Far more often than anybody looks, but not without a break.
                    std::thread::sleep(std::time::Duration::from_micros(100));
                }
            });
        }
        let refused = (0..2000).find_map(|_| site.instance.lock(Role::Outer).err());
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        refused
    });
    assert!(refused.is_none(), "{}", refused.unwrap());
}

#[test]
fn threads_of_a_process_prepare_an_instance_side_by_side() {
    let site = Site::new();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| (0..500).for_each(|_| site.instance.prepare().unwrap()));
        }
    });
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
    let done = std::sync::atomic::AtomicBool::new(false);
    let lost = std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
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
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        lost
    });
    assert_eq!(lost, None);
}
