//! Laws in C, compiled for a test.

use crate::rig::Rig;
use std::path::Path;
use std::path::PathBuf;
use std::process::Command;

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// Compiles a file of the repository into a library of the rig's directory; its path.
pub fn library(rig: &Rig, name: &str, source: &str, flags: &[&str]) -> String {
    let library = rig.file(name);
    let mut compiler = Command::new("gcc");
    compiler
        .args([
            "-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared",
        ])
        .args(flags);
    compiler
        .arg("-I")
        .arg(root().join("shared/ironbird_law/include"));
    compiler
        .arg("-o")
        .arg(&library)
        .arg(root().join(source))
        .arg("-lm");
    assert!(compiler.status().unwrap().success(), "{compiler:?}");
    library
}

pub fn cascade(rig: &Rig) -> String {
    library(rig, "libcascade.so", "examples/law_c/cascade.c", &[])
}

/// The law that misbehaves as `how` says from a tick on, in a settings file that flies it.
pub fn misbehaving(rig: &Rig, how: &str, from_tick: u64) -> String {
    library(
        rig,
        "libmisbehaving.so",
        "bench/rig/tests/laws_c/misbehaving.c",
        &[],
    );
    rig.settings(&format!(
        "[flight]\ntrajectory = \"hover\"\n[inner]\nlaw = \"libmisbehaving.so\"\nmisbehave = \"{how}\"\nfrom_tick = {from_tick}\n"
    ))
}

/// Settings of a law that does harm from a tick on.
pub fn hostile(rig: &Rig, harm: &str, from_tick: u64) -> String {
    library(
        rig,
        "libhostile.so",
        "bench/rig/tests/laws_c/hostile.c",
        &[],
    );
    rig.settings(&format!(
        "[flight]\ntrajectory = \"hover\"\n[inner]\nlaw = \"libhostile.so\"\nharm = \"{harm}\"\nfrom_tick = {from_tick}\n"
    ))
}
