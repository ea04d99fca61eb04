//! A flight of a user to whom nothing is granted.

use std::fs;
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::process::Command;

use super::{Ended, IRONBIRD, Rig, not_tested};

/// A flight of a user without privileges; none where there is no way to become one.
pub fn fly_unprivileged(rig: &Rig, args: &[&str]) -> Option<Ended> {
    const NOBODY: u32 = 65534;
    if !rustix::process::geteuid().is_root() {
        return Some(rig.run("fly", args));
    }
    let id = NOBODY.to_string();
    let as_nobody = ["--reuid", &id, "--regid", &id, "--clear-groups"];
    if !Command::new("setpriv").args(as_nobody).arg("true").status().is_ok_and(|status| status.success()) {
        not_tested("setpriv (util-linux) is not there, or may not become another user");
        return None;
    }
    // Its own copy: the directory of the build may be closed to others.
    let executable = rig.path("ironbird");
    if !executable.exists() {
        fs::copy(IRONBIRD, &executable).unwrap();
        fs::set_permissions(rig.path("."), fs::Permissions::from_mode(0o755)).unwrap();
        for directory in [rig.root(), rig.out()] {
            fs::create_dir(&directory).unwrap();
            chown(&directory, Some(NOBODY), Some(NOBODY)).unwrap();
        }
    }
    let mut command = Command::new("setpriv");
    command.args(as_nobody).arg(executable).arg("fly").args(rig.own_args("fly", args));
    command.env("IRONBIRD_ROOT", rig.root());
    Some(rig.launch(command).end())
}
