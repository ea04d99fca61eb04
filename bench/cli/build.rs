//! Finds out what is built: commit, whether its sources were changed since, profile, compiler, target.
//!
//! Runs again when a source of the executable changes, which has the crate compiled anew in any case, and when the
//! checkout moves to another commit. Not when the index does: what is staged is changed all the same, and to look at a
//! checkout touches it.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

const UNKNOWN: &str = "unknown";

fn main() {
    let manifest = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let root = manifest.ancestors().nth(2).unwrap_or(&manifest);
    let sources = sources(root);
    for source in &sources {
        println!("cargo:rerun-if-changed={}", root.join(source).display());
    }
    let (commit, dirty) = commit(root, &sources).unwrap_or((UNKNOWN.into(), false));
    let variable = |name: &str| env::var(name).unwrap_or_else(|_| UNKNOWN.into());
    for (name, value) in [
        ("COMMIT", commit),
        ("DIRTY", dirty.to_string()),
        ("PROFILE", variable("PROFILE")),
        ("RUSTC", rustc().unwrap_or_else(|| UNKNOWN.into())),
        ("TARGET", variable("TARGET")),
    ] {
        println!("cargo:rustc-env=IRONBIRD_{name}={value}");
    }
}

/// The executable's sources, relative to the root of the workspace: its own files, and the compiled files of each crate.
fn sources(root: &Path) -> Vec<String> {
    let crates = folders(root, "")
        .into_iter()
        .flat_map(|name| [folders(root, &format!("{name}/")), vec![name]].concat());
    // `python` is built upon these crates, and none of them upon it.
    let crates = crates
        .filter(|name| root.join(name).join("Cargo.toml").exists() && !name.starts_with("python"));
    let compiled = ["src", "build.rs", "Cargo.toml"];
    let mut sources: Vec<String> = crates
        .flat_map(|name| compiled.map(|file| format!("{name}/{file}")))
        .collect();
    sources.extend(["Cargo.toml", "Cargo.lock", "rust-toolchain.toml"].map(str::to_owned));
    // One that is not there would have this run every time.
    sources.retain(|source| root.join(source).exists());
    sources.sort();
    sources
}

/// What lies in a folder of the workspace, by its path from the root.
fn folders(root: &Path, within: &str) -> Vec<String> {
    let entries = root.join(within).read_dir().into_iter().flatten().flatten();
    entries
        .filter_map(|entry| Some(format!("{within}{}", entry.file_name().into_string().ok()?)))
        .collect()
}

/// The commit in short, and whether a source of the executable differs from it; nothing where the sources are no
/// checkout of their own, as those of a tarball.
fn commit(root: &Path, sources: &[String]) -> Option<(String, bool)> {
    let toplevel = PathBuf::from(git(root, &["rev-parse", "--show-toplevel"])?);
    if toplevel.canonicalize().ok()? != root.canonicalize().ok()? {
        return None;
    }
    // The reflog grows with every commit and checkout; where there is none, HEAD at least changes with the branch.
    for name in ["HEAD", "logs/HEAD"] {
        let path = root.join(git(root, &["rev-parse", "--git-path", name])?);
        if path.exists() {
            println!("cargo:rerun-if-changed={}", path.display());
        }
    }
    let commit = git(root, &["rev-parse", "--short=7", "HEAD"])?;
    // Without its lock: to look at a checkout must not touch it.
    let status = ["--no-optional-locks", "status", "--porcelain", "--"].into_iter();
    let changed = git(
        root,
        &status
            .chain(sources.iter().map(String::as_str))
            .collect::<Vec<_>>(),
    )?;
    Some((commit, !changed.is_empty()))
}

fn git(root: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git")
        .arg("-C")
        .arg(root)
        .args(arguments)
        .output()
        .ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The version of the compiler, as `1.95.0`.
fn rustc() -> Option<String> {
    let output = Command::new(env::var_os("RUSTC")?)
        .arg("--version")
        .output()
        .ok()?;
    String::from_utf8_lossy(&output.stdout)
        .split_whitespace()
        .nth(1)
        .map(str::to_owned)
}
