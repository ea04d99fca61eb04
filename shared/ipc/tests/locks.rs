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
fn a_role_is_locked_and_seen_as_locked_while_others_look_at_it_and_remove_leftovers() {
    let site = Site::new();
    let instance = &site.instance;
    // Far more often than any process looks, but not without a break.
    let look = || {
        let _ = instance.is_occupied(Role::Inner);
        thread::sleep(Duration::from_micros(100));
    };
    let remove = || drop(instance.remove_leftovers().unwrap());
    for meanwhile in [&look as &(dyn Fn() + Sync), &remove] {
        let done = AtomicBool::new(false);
        let failure = thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    while !done.load(Ordering::Relaxed) {
                        meanwhile();
                    }
                });
            }
            let failure = (0..1000).find_map(|_| {
                // A directory that is removed in this instant is created again.
                let prepared = instance.prepare();
                match prepared.and_then(|()| instance.lock(Role::Inner)) {
                    Ok(_lock) if instance.is_occupied(Role::Inner) => None,
                    Ok(_lock) => Some("the role is locked, and seems free".into()),
                    Err(e) => Some(e.to_string()),
                }
            });
            done.store(true, Ordering::Relaxed);
            failure
        });
        assert_eq!(failure, None);
    }
}
