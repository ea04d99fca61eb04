//! What others can reach is not used: links, foreign directories and files, modes.
//!
//! Locks that are kept are tested here too.

use std::fs::{self, File, Permissions};
use std::io::Write as _;
use std::os::unix::fs::{PermissionsExt as _, chown, symlink};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use ipc::error::Error;
use ipc::instance::{Instance, SHARED_MEMORY};
use ipc::{LATEST, Wire};
use messages::blackboards::ActiveParameters;
use messages::content::{RotorSpeeds, State};
use messages::role::Role;
use rustix::fs::{FlockOperation, flock};

use crate::Site;

const NOBODY: u32 = 65534;
const HANGS: Duration = Duration::from_secs(60);

fn mode(path: &Path) -> u32 {
    path.symlink_metadata().unwrap().permissions().mode() & 0o7777
}

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
}

/// Gives a path to another user; says aloud where that is not possible.
fn give_away(path: &Path) -> bool {
    let given = chown(path, Some(NOBODY), Some(NOBODY)).is_ok();
    if !given {
        writeln!(
            std::io::stderr().lock(),
            "skipped: only root gives {} away",
            path.display()
        )
        .unwrap();
    }
    given
}

fn bells(instance: &Instance) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{}bells", instance.prefix()))
}

/// Demands a usage error that says why a path is not used, and what to do.
fn assert_refused<T>(result: Result<T, Error>, path: &Path, why: &str) {
    let error = result.map(drop).unwrap_err();
    assert_eq!(
        error.to_string(),
        format!("{} is not used: {why}", path.display())
    );
    assert_eq!(error.exit_code(), 2, "{error}");
    assert!(error.remedy().unwrap().contains("IRONBIRD_ROOT"), "{error}");
}

#[test]
fn nothing_is_opened_through_a_link() {
    let site = Site::new();
    let instance = &site.instance;
    let victim = site.root().join("shadow");
    fs::write(&victim, "root:secret").unwrap();
    let is_whole = || assert_eq!(fs::read_to_string(&victim).unwrap(), "root:secret");
    instance.prepare().unwrap();
    for role in ["plant", "fly", "in_use"] {
        let lock = instance.directory().join(format!("{role}.lock"));
        let _ = fs::remove_file(&lock);
        symlink(&victim, &lock).unwrap();
        let why = "it is a symbolic link";
        match role {
            "plant" => assert_refused(instance.lock(Role::Plant), &lock, why),
            "fly" => assert_refused(instance.lock_launcher(), &lock, why),
            _ => assert_refused(Wire::open(instance), &lock, why),
        }
        assert!(!instance.is_occupied(Role::Plant));
        is_whole();
        fs::remove_file(&lock).unwrap();
    }
    let page = bells(instance);
    symlink(&victim, &page).unwrap();
    let refused = Wire::open(instance);
    fs::remove_file(&page).unwrap();
    assert!(
        refused
            .map(drop)
            .unwrap_err()
            .to_string()
            .starts_with(&format!("{} is not used", page.display()))
    );
    is_whole();

    let elsewhere = Site::new();
    fs::create_dir(elsewhere.root().join("private")).unwrap();
    let linked = Instance::under(site.root(), "linked").unwrap();
    symlink(elsewhere.root().join("private"), linked.directory()).unwrap();
    assert_refused(
        linked.prepare(),
        &linked.directory(),
        "it is a symbolic link",
    );
    assert!(
        fs::read_dir(elsewhere.root().join("private"))
            .unwrap()
            .next()
            .is_none()
    );
}

#[test]
fn what_others_may_write_is_not_used() {
    let site = Site::new();
    let instance = &site.instance;
    let others_may = |mode: u32| format!("others may write it: its mode is {mode:04o}");
    for mode in [0o770, 0o777] {
        fs::create_dir_all(instance.directory()).unwrap();
        set_mode(&instance.directory(), mode);
        assert_refused(instance.prepare(), &instance.directory(), &others_may(mode));
        assert_refused(
            Wire::open(instance),
            &instance.directory(),
            &others_may(mode),
        );
        assert!(fs::read_dir(instance.directory()).unwrap().next().is_none());
    }
    fs::remove_dir(instance.directory()).unwrap();
    // A root that everybody may write is good enough where nobody may exchange what another has made, as in /tmp.
    set_mode(site.root(), 0o777);
    assert_refused(instance.prepare(), site.root(), &others_may(0o777));
    set_mode(site.root(), 0o1777);
    instance.prepare().unwrap();
    set_mode(site.root(), 0o755);
    let lock = instance.directory().join("plant.lock");
    fs::write(&lock, "").unwrap();
    set_mode(&lock, 0o666);
    assert_refused(instance.lock(Role::Plant), &lock, &others_may(0o666));
    fs::remove_file(&lock).unwrap();
    fs::write(bells(instance), "").unwrap();
    set_mode(&bells(instance), 0o666);
    // Nobody uses it, so that it goes as a leftover.
    drop(Wire::open(instance).unwrap());
    let wire = Wire::open(instance).unwrap();
    set_mode(&bells(instance), 0o666);
    assert_refused(Wire::open(instance), &bells(instance), &others_may(0o666));
    drop(wire);
}

#[test]
fn what_belongs_to_another_user_is_not_used() {
    let site = Site::new();
    let instance = &site.instance;
    let user = rustix::process::geteuid().as_raw();
    let theirs = format!("it belongs to user {NOBODY}, and this process is user {user}");
    fs::create_dir(instance.directory()).unwrap();
    if !give_away(&instance.directory()) {
        return;
    }
    assert_refused(instance.prepare(), &instance.directory(), &theirs);
    assert_eq!(instance.remove_leftovers().unwrap(), Vec::<PathBuf>::new());
    assert!(instance.directory().exists());
    fs::remove_dir(instance.directory()).unwrap();

    give_away(site.root());
    assert_refused(instance.prepare(), site.root(), &theirs);
    assert!(!instance.directory().exists());
    chown(site.root(), Some(user), None).unwrap();

    instance.prepare().unwrap();
    let lock = instance.directory().join("plant.lock");
    fs::write(&lock, "").unwrap();
    give_away(&lock);
    assert_refused(instance.lock(Role::Plant), &lock, &theirs);
    instance.remove_leftovers().unwrap();
    assert!(lock.exists(), "another user's file stays");
    fs::remove_file(&lock).unwrap();

    fs::write(bells(instance), "").unwrap();
    give_away(&bells(instance));
    let refused = Wire::open(instance).map(drop);
    fs::remove_file(bells(instance)).unwrap();
    let error = refused.unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with(&format!("{} is not used", bells(instance).display())),
        "{error}"
    );
}

#[test]
fn what_an_instance_makes_is_its_users_alone() {
    let site = Site::new();
    let instance = &site.instance;
    instance.prepare().unwrap();
    let _lock = instance.lock(Role::Plant).unwrap();
    let wire = site.wire();
    let _ports = (
        wire.sender::<State>(None).unwrap(),
        wire.receiver::<RotorSpeeds>(LATEST).unwrap(),
    );
    let _board = wire.blackboard::<ActiveParameters>("in_force").unwrap();
    assert_eq!(mode(&instance.directory()), 0o700);
    let entries = |path: &Path| {
        fs::read_dir(path)
            .unwrap()
            .map(|entry| entry.unwrap().path())
    };
    for entry in entries(&instance.directory()) {
        // The middleware's own directories can be listed by others, who do not come so far.
        assert!(entry.is_dir() || mode(&entry) == 0o600);
        assert_eq!(mode(&entry) & 0o022, 0, "{}", entry.display());
    }
    let prefix = instance.prefix();
    for entry in entries(Path::new(SHARED_MEMORY)) {
        let name = entry.file_name().unwrap().to_str().unwrap();
        if name.starts_with(&prefix) {
            assert_eq!(mode(&entry), 0o600, "{name}");
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_lock_that_somebody_keeps_is_an_error_and_no_wait_for_ever() {
    let keep = |path: &Path| {
        let kept = File::open(path).unwrap();
        flock(&kept, FlockOperation::NonBlockingLockExclusive).unwrap();
        kept
    };
    let sites = [Site::new(), Site::new(), Site::new()];
    let mut kept = Vec::new();
    let (said, heard) = mpsc::channel();
    let [directory, in_use, page] = [&sites[0], &sites[1], &sites[2]].map(|site| {
        drop(site.wire());
        &site.instance
    });
    let in_use_lock = |instance: &Instance| instance.directory().join("in_use.lock");
    // Somebody uses the memory, so that the page is no leftover.
    let user = File::open(in_use_lock(page)).unwrap();
    flock(&user, FlockOperation::NonBlockingLockShared).unwrap();
    fs::write(bells(page), "").unwrap();
    set_mode(&bells(page), 0o600);
    for (instance, path) in [
        (directory, directory.directory()),
        (in_use, in_use_lock(in_use)),
        (page, bells(page)),
    ] {
        kept.push(keep(&path));
        let (instance, said) = (instance.clone(), said.clone());
        std::thread::spawn(move || {
            let error = Wire::open(&instance)
                .map(drop)
                .map_err(|e| (e.to_string(), e.exit_code(), e.remedy()));
            said.send((path, error))
        });
    }
    for _ in &sites {
        let (path, result) = heard.recv_timeout(HANGS).expect("it waits for ever");
        let path = path.display();
        let (words, exit_code, remedy) = result.unwrap_err();
        assert_eq!(
            (words, exit_code),
            (format!("another process has locked {path} for 5 s"), 5)
        );
        assert_eq!(
            remedy.unwrap(),
            format!("`fuser -v {path}` names the process")
        );
    }
    drop((kept, user));
}
