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

/// Settings of a flight with the law of a file in `laws_c`, which does what it is given from a tick on. Nothing ends the
/// flight early, however busy the machine is.
fn harmful(rig: &Rig, name: &str, harm: &str) -> String {
    let source = format!("bench/rig/tests/laws_c/{name}.c");
    library(rig, &format!("lib{name}.so"), &source, &[]);
    rig.airborne(&format!(
        "trajectory = \"hover\"\n[inner]\nlaw = \"lib{name}.so\"\n{harm}\n"
    ))
}

pub fn misbehaving(rig: &Rig, how: &str, from_tick: u64) -> String {
    let harm = format!("misbehave = \"{how}\"\nfrom_tick = {from_tick}");
    harmful(rig, "misbehaving", &harm)
}

pub fn hostile(rig: &Rig, harm: &str, from_tick: u64) -> String {
    let harm = format!("harm = \"{harm}\"\nfrom_tick = {from_tick}");
    harmful(rig, "hostile", &harm)
}
