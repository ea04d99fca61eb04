//! The directory under which instances live: which one it is, and its one spelling.

use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Component, Path, PathBuf};

use rustix::process::geteuid;

use super::directory::not_ours;
use crate::error::Error;

/// Names the directory under which instances keep their locks and service files.
pub const ROOT_VARIABLE: &str = "IRONBIRD_ROOT";
/// Longest root path: the middleware's paths hold 255 bytes, and what it makes below takes up to 185 of them.
pub(super) const ROOT_MAX: usize = 64;
const SESSION_VARIABLE: &str = "XDG_RUNTIME_DIR";

/// The directory under which instances live: `IRONBIRD_ROOT`, else one in the directory of the user's session, else
/// one in /tmp that carries the user's number.
pub fn root_path() -> PathBuf {
    named()
        .or_else(in_session)
        .unwrap_or_else(|| PathBuf::from(format!("/tmp/ironbird-{}", geteuid().as_raw())))
}

fn named() -> Option<PathBuf> {
    std::env::var_os(ROOT_VARIABLE)
        .filter(|root| !root.is_empty())
        .map(PathBuf::from)
}

fn in_session() -> Option<PathBuf> {
    let session = PathBuf::from(std::env::var_os(SESSION_VARIABLE)?);
    // After `sudo` it may be another user's.
    let metadata = session.symlink_metadata().ok()?;
    let is_ours =
        session.is_absolute() && metadata.is_dir() && metadata.uid() == geteuid().as_raw();
    let root = session.join("ironbird");
    (is_ours && root.as_os_str().len() <= ROOT_MAX).then_some(root)
}

/// The root of the environment, under its one spelling.
pub(super) fn root() -> Result<PathBuf, Error> {
    let root = root_path();
    // A link that the user names is the user's; in a place that everybody can guess, it may be anybody's.
    if named().is_none()
        && root
            .symlink_metadata()
            .is_ok_and(|there| there.is_symlink())
    {
        return Err(not_ours(root, "it is a symbolic link"));
    }
    one_spelling(&root)
}

/// The one spelling of a path, whether it is there or not: an instance's shared memory carries it.
pub(super) fn one_spelling(path: &Path) -> Result<PathBuf, Error> {
    resolve(path).map_err(|source| Error::path(path, source))
}

fn resolve(path: &Path) -> io::Result<PathBuf> {
    let mut there = std::path::absolute(path)?;
    let mut missing = Vec::new();
    loop {
        match there.canonicalize() {
            Ok(found) => {
                return Ok(missing
                    .iter()
                    .rev()
                    .fold(found, |path, name| path.join(name)));
            }
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            Err(e) => match there.components().next_back() {
                Some(Component::Normal(name)) => missing.push(name.to_owned()),
                // `..` of something that is not there.
                _ => return Err(e),
            },
        }
        there.pop();
    }
}
