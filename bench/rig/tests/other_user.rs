//! Another user of the machine beside a flight: he reads, writes, shrinks and removes nothing of it. Real processes.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::{Rig, not_tested};
use rustix::process::Signal;

/// Options of setpriv that make a process one of a user who owns nothing.
const AS_NOBODY: [&str; 3] = ["--reuid=65534", "--regid=65534", "--clear-groups"];

/// A shell's script run by another user, with a path as `$0`; none where nobody else can be become.
fn by_nobody(script: &str, path: &Path) -> Option<bool> {
    let permitted = Command::new("setpriv").args(AS_NOBODY).arg("true").status();
    if !permitted.is_ok_and(|status| status.success()) {
        not_tested(
            "what another user may do: setpriv (util-linux) is not there, or may not become another user",
        );
        return None;
    }
    let mut command = Command::new("setpriv");
    command
        .args(AS_NOBODY)
        .args(["sh", "-c", script])
        .arg(path)
        .current_dir("/");
    Some(command.output().unwrap().status.success())
}

/// The files of an instance in shared memory.
fn segments(rig: &Rig) -> Vec<PathBuf> {
    rig.segments()
        .iter()
        .map(|name| Path::new("/dev/shm").join(name))
        .collect()
}

#[test]
fn another_user_can_neither_look_at_a_flight_nor_disturb_it() {
    let rig = Rig::new("beside");
    if by_nobody("true", Path::new("/")).is_none() {
        return;
    }
    let flight = rig.take_off("--rt off --duration 600s");
    fs::set_permissions(rig.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    let directory = rig.known().directory();
    let segments = segments(&rig);
    let lengths = || {
        segments
            .iter()
            .map(|path| path.metadata().unwrap().len())
            .collect::<Vec<_>>()
    };
    let (before, plant) = (lengths(), flight.roles()["plant"]);
    assert!(
        segments
            .iter()
            .any(|path| path.to_string_lossy().ends_with(".global_mgmt")),
        "{segments:?}"
    );
    let tries = [
        "cat \"$0\" >/dev/null",
        ": >>\"$0\"",
        "truncate -s 0 \"$0\"",
        "rm -f \"$0\"",
        "mv \"$0\" /tmp",
        "chmod 666 \"$0\"",
    ];
    let locks = ["plant.lock", "in_use.lock"].map(|lock| directory.join(lock));
    for script in tries {
        for path in segments.iter().chain(&locks) {
            assert_eq!(
                by_nobody(script, path),
                Some(false),
                "{script} {}",
                path.display()
            );
        }
    }
    for script in [
        "ls \"$0\"",
        "touch \"$0\"/x",
        "flock -n \"$0\" true",
        "rmdir \"$0\"",
    ] {
        assert_eq!(by_nobody(script, &directory), Some(false), "{script}");
    }
    assert_eq!(
        by_nobody(&format!("kill -0 {plant}"), &directory),
        Some(false)
    );
    assert_eq!(lengths(), before);
    rig.ok("inject mass_kg=0.6");
    flight.signal(Signal::INT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn what_another_user_has_put_in_the_way_is_refused_and_stays() {
    let rig = Rig::new("squatted");
    fs::create_dir(rig.root()).unwrap();
    fs::set_permissions(rig.root(), fs::Permissions::from_mode(0o1777)).unwrap();
    fs::set_permissions(rig.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    let victim = rig.path("victim");
    fs::write(&victim, "kept").unwrap();
    let place = rig.known().directory();
    let bells = PathBuf::from(format!("/dev/shm/{}bells", rig.known().prefix()));
    for (script, path, words) in [
        (
            "mkdir \"$0\"",
            &place,
            "it belongs to user 65534, and this process is user",
        ),
        ("ln -s /etc \"$0\"", &place, "it is a symbolic link"),
        ("mkfifo \"$0\"", &place, "it is no directory"),
        (": >\"$0\"", &bells, "is not used"),
        ("mkdir \"$0\"", &bells, "is not used"),
        ("mkfifo \"$0\"", &bells, "is not used"),
        ("ln -s / \"$0\"", &bells, "is not used"),
    ] {
        let Some(done) = by_nobody(script, path) else {
            return;
        };
        assert!(done, "{script} {}", path.display());
        let there = path.symlink_metadata().unwrap();
        rig.refused("fly --rt off --duration 100ms")
            .complains(words);
        rig.ok("clean");
        assert_eq!(
            path.symlink_metadata().unwrap().ino(),
            there.ino(),
            "{script}: it stays"
        );
        if there.is_dir() {
            fs::remove_dir(path).unwrap()
        } else {
            fs::remove_file(path).unwrap()
        }
    }
    assert!(
        rig.run_directories().is_empty(),
        "{:?}",
        rig.run_directories()
    );
    // What is put into a place that a flight writes to is replaced, and what it leads to stays.
    rig.ok("fly --pace lockstep --duration 50ms");
    let exported = rig.path("exported");
    fs::create_dir(&exported).unwrap();
    symlink(&victim, exported.join("state.csv")).unwrap();
    rig.ok(&format!("export --to {}", exported.to_str().unwrap()));
    assert_eq!(fs::read_to_string(&victim).unwrap(), "kept");
}
