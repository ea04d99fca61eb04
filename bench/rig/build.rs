//! Finds out what is built: commit, whether its sources were changed since, profile, compiler, target.
//!
//! Runs again only when the checkout moves to another commit or a source of the executable changes, and then the crate is
//! compiled anew in any case.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What the executable is made of, from the root of the workspace.
const SOURCES: [&str; 8] =
    ["Cargo.toml", "Cargo.lock", "rust-toolchain.toml", "shared", "plant", "controller", "mixer", "bench"];

const UNKNOWN: &str = "unknown";

fn main() {
    let manifest = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let root = manifest.ancestors().nth(2).unwrap_or(&manifest);
    for source in SOURCES.iter().map(|source| root.join(source)).filter(|source| source.exists()) {
        println!("cargo:rerun-if-changed={}", source.display());
    }
    let (commit, dirty) = commit(root).unwrap_or((UNKNOWN.into(), false));
    let told = |name: &str| env::var(name).unwrap_or_else(|_| UNKNOWN.into());
    for (name, value) in [
        ("COMMIT", commit),
        ("DIRTY", dirty.to_string()),
        ("PROFILE", told("PROFILE")),
        ("RUSTC", rustc().unwrap_or_else(|| UNKNOWN.into())),
        ("TARGET", told("TARGET")),
    ] {
        println!("cargo:rustc-env=IRONBIRD_{name}={value}");
    }
}

/// The commit in short, and whether a source of the executable differs from it; nothing where the sources are no
/// checkout of their own, as those of a tarball.
fn commit(root: &Path) -> Option<(String, bool)> {
    let toplevel = PathBuf::from(git(root, &["rev-parse", "--show-toplevel"])?);
    if toplevel.canonicalize().ok()? != root.canonicalize().ok()? {
        return None;
    }
    // The reflog grows with every commit and checkout; where there is none, HEAD tells at least of other branches.
    for name in ["HEAD", "logs/HEAD"] {
        let path = root.join(git(root, &["rev-parse", "--git-path", name])?);
        if path.exists() {
            println!("cargo:rerun-if-changed={}", path.display());
        }
    }
    let commit = git(root, &["rev-parse", "--short=7", "HEAD"])?;
    // Without its lock: to look at a checkout must not touch it.
    let changed = git(root, &[&["--no-optional-locks", "status", "--porcelain", "--"], &SOURCES[..]].concat())?;
    Some((commit, !changed.is_empty()))
}

fn git(root: &Path, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(root).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The version of the compiler, as `1.95.0`.
fn rustc() -> Option<String> {
    let output = Command::new(env::var_os("RUSTC")?).arg("--version").output().ok()?;
    String::from_utf8_lossy(&output.stdout).split_whitespace().nth(1).map(str::to_owned)
}
