//! What a user does to whom nothing is granted.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::process::Command;

use super::{Rig, copy_executable, not_tested};

const USER_ID: u32 = 65534;

/// `ironbird COMMAND` of a user without privileges, who owns new directories of the rig; none where there is no way to
/// become one.
pub fn unprivileged(rig: &Rig, command: &str, args: impl AsRef<str>) -> Option<Command> {
    if !rustix::process::geteuid().is_root() {
        return Some(rig.command(command, args));
    }
    let id = USER_ID.to_string();
    let as_other_user = ["--reuid", &id, "--regid", &id, "--clear-groups"];
    let probe = Command::new("setpriv")
        .args(as_other_user)
        .arg("true")
        .status();
    if !probe.is_ok_and(|status| status.success()) {
        not_tested("setpriv (util-linux) is not there, or may not become another user");
        return None;
    }
    // Its own copy: the directory of the build may be closed to others.
    let executable = rig.path("ironbird");
    if !executable.exists() {
        copy_executable(&executable);
        fs::set_permissions(rig.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    }
    for directory in [rig.root(), rig.out()] {
        if ["fly", "doctor"].contains(&command) && !directory.exists() {
            fs::create_dir(&directory).unwrap();
            chown(&directory, Some(USER_ID), Some(USER_ID)).unwrap();
        }
    }
    let mut process = Command::new("setpriv");
    process.args(as_other_user).arg(executable);
    Some(rig.given(process, command, args))
}
