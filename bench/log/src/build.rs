//! Which build this is: what distinguishes two executables of one version.

use std::fmt;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

/// Stands for what is not known, as the commit of sources without git.
const UNKNOWN: &str = "unknown";

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    pub version: String,
    pub commit: String,
    pub dirty: bool,
    pub profile: String,
    pub rustc: String,
    pub target: String,
}

/// The build of this executable, as its main function has declared it.
static EXECUTABLE: OnceLock<Build> = OnceLock::new();

/// Declares which build this executable is; the first call counts.
pub fn set_executable(build: Build) {
    EXECUTABLE.get_or_init(|| build);
}

/// The build of this executable; all but its version is unknown where nothing has been declared, as in a library's tests.
pub fn executable() -> Build {
    EXECUTABLE.get().cloned().unwrap_or_else(|| Build {
        version: env!("CARGO_PKG_VERSION").into(),
        ..Build::default()
    })
}

impl Build {
    pub fn token(&self) -> String {
        let dirty = if self.dirty { "-dirty" } else { "" };
        format!("{}{dirty}-{}", self.commit, self.profile)
    }

    /// How it compares with another one, as a sentence can end.
    pub fn compared_with(&self, other: &Self) -> &'static str {
        if self != other {
            "different"
        } else if self.commit == UNKNOWN {
            "of one version, from an unknown commit"
        } else if self.dirty {
            "the same commit, with changes that may differ"
        } else {
            "the same"
        }
    }
}

/// A build of which nothing is known.
impl Default for Build {
    fn default() -> Self {
        let unknown = || UNKNOWN.to_owned();
        Self {
            version: unknown(),
            commit: unknown(),
            dirty: false,
            profile: unknown(),
            rustc: unknown(),
            target: unknown(),
        }
    }
}

impl fmt::Display for Build {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (version, rustc) = (&self.version, &self.rustc);
        let (commit, profile) = (&self.commit, &self.profile);
        if commit == UNKNOWN && profile == UNKNOWN {
            return write!(f, "{version} (build unknown)");
        }
        let dirty = if self.dirty { " dirty" } else { "" };
        write!(f, "{version} ({commit}{dirty}, {profile}, rustc {rustc})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn builds_are_told_apart_by_commit_changes_and_profile() {
        let build = Build {
            version: "0.1.0".into(),
            commit: "7fa27a4".into(),
            dirty: true,
            profile: "release".into(),
            rustc: "1.95.0".into(),
            target: "x86_64-unknown-linux-gnu".into(),
        };
        let clean = Build {
            dirty: false,
            ..build.clone()
        };
        let debug = Build {
            profile: "debug".into(),
            ..clean.clone()
        };
        for (build, text, token) in [
            (&build, "7fa27a4 dirty, release", "7fa27a4-dirty-release"),
            (&clean, "7fa27a4, release", "7fa27a4-release"),
        ] {
            let text = format!("0.1.0 ({text}, rustc 1.95.0)");
            assert_eq!((build.to_string(), &*build.token()), (text, token));
        }
        let unknown = Build::default();
        assert_eq!(unknown.to_string(), "unknown (build unknown)");
        let changed = "the same commit, with changes that may differ";
        for (a, b, words) in [
            (&clean, &clean, "the same"),
            (&clean, &debug, "different"),
            (&clean, &build, "different"),
            (&build, &build, changed),
            (&unknown, &clean, "different"),
            (&unknown, &unknown, "of one version, from an unknown commit"),
        ] {
            assert_eq!(a.compared_with(b), words, "{a} and {b}");
        }
    }
}
