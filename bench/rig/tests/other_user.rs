//! Another user of the machine beside a flight: he reads, writes, shrinks and removes nothing of it. Real processes.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::{Rig, not_tested};

/// Options of setpriv that make a process one of a user who owns nothing.
const AS_NOBODY: [&str; 3] = ["--reuid=65534", "--regid=65534", "--clear-groups"];

/// A shell's script run by another user, with a path as `$0`; none where nobody else can be become.
fn by_nobody(script: &str, path: &Path) -> Option<bool> {
    let permitted = Command::new("setpriv").args(AS_NOBODY).arg("true").status();
    if !permitted.is_ok_and(|status| status.success()) {
        not_tested("what another user may do: setpriv is not there, or may not become one");
        return None;
    }
    let mut command = Command::new("setpriv");
    command.args(AS_NOBODY).args(["sh", "-c", script]).arg(path);
    Some(command.current_dir("/").output().unwrap().status.success())
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
    let segments = rig.segments().into_iter();
    let segments: Vec<PathBuf> = segments.map(|it| Path::new("/dev/shm").join(it)).collect();
    let length = |path: &PathBuf| path.metadata().unwrap().len();
    let lengths = || segments.iter().map(length).collect::<Vec<_>>();
    let before = lengths();
    let is_counter = |path: &PathBuf| path.extension().is_some_and(|it| it == "global_mgmt");
    assert!(segments.iter().any(is_counter), "{segments:?}");
    let locks = ["plant.lock", "in_use.lock"].map(|lock| directory.join(lock));
    for script in [
        "cat \"$0\" >/dev/null",
        ": >>\"$0\"",
        "truncate -s 0 \"$0\"",
        "rm -f \"$0\"",
        "mv \"$0\" /tmp",
        "chmod 666 \"$0\"",
    ] {
        for path in segments.iter().chain(&locks) {
            assert_eq!(by_nobody(script, path), Some(false), "{script} {path:?}");
        }
    }
    let signal = format!("kill -0 {}", flight.roles()["plant"]);
    for script in [
        "ls \"$0\"",
        "touch \"$0\"/x",
        "flock -n \"$0\" true",
        "rmdir \"$0\"",
        &signal,
    ] {
        assert_eq!(by_nobody(script, &directory), Some(false), "{script}");
    }
    assert_eq!(lengths(), before);
    rig.ok("inject mass_kg=0.6");
    flight.interrupt().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn what_another_user_has_put_in_the_way_is_refused_and_stays() {
    let rig = Rig::new("squatted");
    fs::create_dir(rig.root()).unwrap();
    fs::set_permissions(rig.root(), fs::Permissions::from_mode(0o1777)).unwrap();
    fs::set_permissions(rig.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    let place = rig.known().directory();
    let bells = PathBuf::from(format!("/dev/shm/{}bells", rig.known().prefix()));
    let owner = "it belongs to user 65534, and this process is user";
    for (script, path, words) in [
        ("mkdir \"$0\"", &place, owner),
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
        let inode = || path.symlink_metadata().unwrap().ino();
        let before = inode();
        rig.refused("fly --rt off --duration 100ms")
            .complains(words);
        rig.ok("clean");
        assert_eq!(inode(), before, "{script}: it stays");
        fs::remove_dir(path)
            .or_else(|_| fs::remove_file(path))
            .unwrap();
    }
    assert_eq!(rig.run_directories(), [""; 0]);
}
