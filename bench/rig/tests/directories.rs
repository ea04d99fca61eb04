//! The directories of an instance and of flights, and the link `latest`.

use crate::endings::kill_all;
use crate::rig::unprivileged::unprivileged;
use crate::rig::{Rig, not_tested};
use messages::role::Role;
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
    for file in ["src/deep/main.c", "work/thesis", "notes"] {
        fs::write(home.join(file), "mine").unwrap();
    }
    symlink(home.join("src"), home.join("link")).unwrap();
    UnixListener::bind(home.join("bus")).unwrap();
}

/// Everything below a directory with what is in it, links not followed.
fn everything_below(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let (path, kind) = (entry.path(), entry.file_type().unwrap());
        if kind.is_dir() {
            found.append(&mut everything_below(&path));
        }
        let is_file = kind.is_file();
        let content = is_file.then(|| fs::read(&path).unwrap());
        found.insert(path, content.unwrap_or_default());
    }
    found
}

#[test]
fn clean_takes_what_is_ours_from_a_root_that_is_a_home_directory_and_nothing_else() {
    let rig = Rig::new("homely");
    fs::create_dir(rig.root()).unwrap();
    furnish(&rig.root());
    let had = everything_below(&rig.root());
    rig.ok("clean").says("nothing to remove");
    assert_eq!(everything_below(&rig.root()), had);

    // A living instance keeps its own.
    let bystander = rig.start("plant", "--rt off --instance bystander");
    bystander.await_words("waiting for");
    kill_all(rig.take_off(rig.slowly(1000, "60s")));
    let directory = rig.known().directory();
    let allow = |mode| fs::set_permissions(&directory, fs::Permissions::from_mode(mode)).unwrap();
    allow(0o770);
    rig.ok("clean").says(&format!(
        "kept the shared memory of instance `{}`: {} is not used",
        rig.instance,
        directory.display()
    ));
    allow(0o700);
    let (left, segments) = (everything_below(&rig.root()), rig.segments());
    assert!(!segments.is_empty() && left.len() > had.len());
    let mut announced = rig.ok("clean --dry-run");
    for name in &segments {
        announced = announced.says(&format!("would remove /dev/shm/{name}\n"));
    }
    let announced = announced
        .says(&format!("would remove {}\n", directory.display()))
        .says("instance `bystander` is alive");
    assert_eq!(
        (everything_below(&rig.root()), rig.segments()),
        (left, segments)
    );
    let removed = rig.ok("clean").stdout;
    for line in announced
        .stdout
        .lines()
        .filter(|it| it.starts_with("would"))
    {
        let line = line.replace("would remove", "removed");
        assert!(removed.contains(&line), "no `{line}` in {removed}");
    }
    rig.assert_nothing_left();
    bystander.signal(Signal::TERM);
    bystander.end().expect(130);
    assert_eq!(everything_below(&rig.root()), had);
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
