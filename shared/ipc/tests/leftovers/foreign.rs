//! What ironbird has not made: it stays, wherever it lies, and is named.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{chown, symlink};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use ipc::Wire;
use ipc::instance::{Instance, SHARED_MEMORY};
use messages::role::Role;

use crate::common::Site;
use crate::{hold_everything_and_be_killed, segments};

const OTHER_USER: u32 = 65534;

/// Puts into a directory what a user may have there: a tree, a file, a socket, a pipe, links.
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
    let in_it = "is no directory of ironbird: in it lie `bus`, `dangling`, `deep` and 4 more";
    for (name, words) in [
        ("src", in_it),
        ("notes", "is not used: it is no directory"),
        ("bus", "is not used: it is no directory"),
        ("link", "is not used: it is a symbolic link"),
        ("dangling", "is not used: it is a symbolic link"),
    ] {
        let words = format!("home/{name} {words}");
        let instance = Instance::under(&home, name).unwrap();
        assert!(instance.remove_leftovers().unwrap().is_empty(), "{name}");
        assert!(instance.leftovers().is_empty(), "{name}");
        assert_eq!(everything_below(&home), had, "{name}");
        for error in [
            instance.prepare().unwrap_err(),
            instance.lock(Role::Plant).map(drop).unwrap_err(),
            Wire::open(&instance).map(drop).unwrap_err(),
        ] {
            assert!(error.to_string().ends_with(&words), "{name}: {error}");
            assert_eq!(error.exit_code(), 2, "{name}");
            assert!(error.remedy().unwrap().contains("IRONBIRD_ROOT"), "{name}");
        }
        assert_eq!(everything_below(&home), had, "{name}");
    }
    // An empty one has no owner.
    fs::create_dir(home.join("empty")).unwrap();
    let empty = Instance::under(&home, "empty").unwrap();
    assert_eq!(empty.remove_leftovers().unwrap(), Vec::<PathBuf>::new());
    assert!(home.join("empty").exists(), "it was never used");
    empty.prepare().unwrap();
    assert_eq!(empty.remove_leftovers().unwrap(), [home.join("empty")]);
    assert_eq!(everything_below(&home), had);
}

#[test]
fn in_shared_memory_only_files_of_this_user_are_removed() {
    let site = Site::new();
    hold_everything_and_be_killed(&site.instance);
    let ours = segments(&site.instance);
    let name =
        |what: &str| Path::new(SHARED_MEMORY).join(format!("{}{what}", site.instance.prefix()));
    symlink("/nowhere", name("link")).unwrap();
    fs::create_dir(name("directory")).unwrap();
    fs::write(name("file"), "of another user").unwrap();
    let is_of_other_user = chown(name("file"), Some(OTHER_USER), Some(OTHER_USER)).is_ok();
    let removed = BTreeSet::from_iter(site.instance.remove_leftovers().unwrap());
    let exists = |what| name(what).symlink_metadata().is_ok();
    let kept = ["link", "directory", "file"].map(exists);
    let refused = Wire::open(&site.instance).map(drop);
    fs::remove_file(name("link")).unwrap();
    fs::remove_dir(name("directory")).unwrap();
    let _ = fs::remove_file(name("file"));
    assert!(ours.is_subset(&removed) && ours.iter().all(|path| !path.exists()));
    assert_eq!(kept, [true, true, is_of_other_user]);
    let error = refused.unwrap_err();
    assert!(
        error
            .to_string()
            .contains("it has a name of this instance, and is no file of this user"),
        "{error}"
    );
    drop(site.wire());
}
