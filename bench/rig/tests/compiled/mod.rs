//! Laws in C, compiled for a test.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::Rig;

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// Compiles a file of the repository into a library of the rig's directory; its path.
pub fn library(rig: &Rig, name: &str, source: &str, flags: &[&str]) -> String {
    let library = rig.file(name);
    let mut compiler = Command::new("gcc");
    compiler.args(["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]).args(flags);
    compiler.arg("-I").arg(root().join("shared/ironbird_law/include"));
    compiler.arg("-o").arg(&library).arg(root().join(source)).arg("-lm");
    assert!(compiler.status().unwrap().success(), "{compiler:?}");
    library
}

/// The cascade of examples/law_c.
pub fn cascade(rig: &Rig) -> String {
    library(rig, "libcascade.so", "examples/law_c/cascade.c", &[])
}

/// The law that misbehaves as `how` says from a tick on, in a settings file that flies it.
pub fn misbehaving(rig: &Rig, how: &str, from_tick: u64) -> String {
    library(rig, "libmisbehaving.so", "bench/rig/tests/laws_c/misbehaving.c", &[]);
    rig.settings(&format!(
        "[flight]\ntrajectory = \"hover\"\n[inner]\nlaw = \"libmisbehaving.so\"\nmisbehave = \"{how}\"\nfrom_tick = {from_tick}\n"
    ))
}
