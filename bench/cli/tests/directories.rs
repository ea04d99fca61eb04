//! The directories of an instance and of flights, and the link `latest`.

use crate::rig::unprivileged::unprivileged;
use crate::rig::{Rig, not_tested};
use messages::role::Role;
use rustix::process::Signal;
use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
use std::path::PathBuf;

const NOBODY: u32 = 65534;

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
        let holder = fs::read_to_string(&lock).unwrap();
        assert_eq!(holder.trim(), plant.pid().to_string());
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
    let mut left = fs::read_dir(session.join("ironbird")).unwrap();
    assert!(left.next().is_none());
}

#[test]
fn a_flight_that_cannot_be_looked_at_is_not_said_to_be_none() {
    let rig = Rig::new("hidden");
    let instance = rig.known();
    instance.prepare().unwrap();
    let lock = instance.lock(Role::Plant).unwrap();
    let in_use = instance.directory().join("in_use.lock");
    let commands = [["params", "--json"], ["inject", "mass_kg=0.5"]];
    fs::create_dir(&in_use).unwrap();
    for [command, args] in commands {
        let ended = rig.run(command, args).expect(2);
        let ended = ended.complains("/in_use.lock: Is a directory");
        assert!(!ended.stderr.contains("start one"), "{ended}");
    }
    fs::remove_dir(&in_use).unwrap();

    // Another user, who may not look.
    if !rustix::process::geteuid().is_root() {
        return not_tested("a flight of another user: this user may not become one");
    }
    for [command, args] in commands {
        let Some(command) = unprivileged(&rig, command, args) else {
            return;
        };
        fs::set_permissions(rig.root(), fs::Permissions::from_mode(0o755)).unwrap();
        let ended = rig.launch(command).end().expect(2);
        let ended = ended.complains("/plant.lock: Permission denied");
        assert!(!ended.stderr.contains("start one"), "{ended}");
    }
    drop(lock);
}
