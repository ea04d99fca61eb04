//! What can go wrong outside the laws, and what to do about each error.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use errors::{FAILED, Failure, INTERRUPTED, NO_REAL_TIME, OCCUPIED, USAGE};
use thiserror::Error;

use crate::shortage::{self, SHARED_MEMORY, Shortage, shortage};
use messages::role::Role;

/// Why a process of the rig cannot go on.
#[derive(Debug, Error)]
pub enum Error {
    /// The name of an instance has a character or a length that file names cannot carry everywhere.
    #[error(
        "instance name `{name}` is not allowed: 1 to 32 of the characters a-z, 0-9, `_` and `-`"
    )]
    InstanceName { name: String },
    /// The directory for sockets and service files, or something in it or in shared memory, cannot be used.
    #[error("cannot use {}: {source}", path.display())]
    RootPath { path: PathBuf, source: io::Error },
    /// The root path is so long that the middleware has no room for what it makes below it.
    #[error("the root path {} is {length} characters long; iceoryx2's paths below it need it to be at most {max}", path.display())]
    RootPathTooLong {
        path: PathBuf,
        length: usize,
        max: usize,
    },
    /// Something in the way belongs to somebody else, or can be written by others.
    #[error("{} is not used: {why}", path.display())]
    NotOurs {
        path: PathBuf,
        /// Its owner, its mode or its kind.
        why: String,
    },
    /// The instance's directory is there, holds something, and is none of ours.
    #[error("{} is no directory of ironbird: in it {}", path.display(), listed(names))]
    ForeignDirectory { path: PathBuf, names: Vec<String> },
    /// A lock that is held for instants is kept.
    #[error("another process has locked {} for {} s", path.display(), waited.as_secs())]
    Held {
        path: PathBuf,
        /// How long it was waited for.
        waited: Duration,
    },
    /// Something that the system gives out is used up.
    #[error("{what}: {used_up}")]
    UsedUp {
        what: String,
        /// What there is no more of.
        used_up: String,
        remedy: String,
    },
    #[error("instance `{instance}` already has a running {role}{}", process(*pid))]
    Occupied {
        instance: String,
        role: String,
        /// Who holds it; not known in the instant before it has written its number.
        pid: Option<u32>,
    },
    /// A process that played the role has ended, and its lock has not.
    #[error(
        "instance `{instance}`: its {role} (process {pid}) has ended, but a process that it left keeps its lock"
    )]
    Orphaned {
        instance: String,
        role: String,
        /// The process that took the lock.
        pid: u32,
        path: PathBuf,
    },
    /// As many processes observe the instance as may.
    #[error("instance `{instance}` has {most} observers already, and that is the most")]
    Crowded { instance: String, most: usize },
    /// A role flies with other settings than the plant.
    #[error("the {role} process has other settings than the plant: {differences}")]
    SettingsDiffer {
        role: Role,
        /// Each differing key with both values.
        differences: String,
        /// The options that choose the plant's laws, where the role has others.
        laws: String,
    },
    /// Real time was required and not granted.
    #[error("real time was required and not granted to the {role} process: {refused}")]
    RealtimeRefused {
        role: Role,
        /// Each refused step with the system's reason.
        refused: String,
        /// What to do about each of them.
        remedy: String,
    },
    /// Shared memory is too small for the instance.
    #[error("shared memory is too small: {path} has {free_mib} MiB free, this instance needs {needed_mib} MiB", path = path.display())]
    SharedMemoryFull {
        path: PathBuf,
        /// What is free [MiB].
        free_mib: u64,
        /// What is needed [MiB].
        needed_mib: u64,
    },
    #[error("{what}: iceoryx2 says {reason}")]
    Wire { what: String, reason: String },
    /// Shared memory was left by another build.
    #[error("{what} exists with an incompatible layout: iceoryx2 says {reason}")]
    Incompatible { what: String, reason: String },
    /// Another process did not do its part in time.
    #[error("{what}")]
    Absent { what: String },
    /// The run goes on without this process: it began without it, or is another one now.
    #[error("{what}")]
    TooLate {
        /// What has happened, and what to start again.
        what: String,
    },
    /// There is no room for as much as was asked for.
    #[error("{what}")]
    TooMuch {
        /// What there is too much of, and how much is allowed.
        what: String,
    },
    /// A thread of this process panicked.
    #[error("{thread} panicked")]
    Panicked { thread: &'static str },
    #[error("{what}: {source}")]
    System { what: String, source: io::Error },
    /// Ended by a signal before the run began.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// Exit code of a process that ends with this error (docs/architecture.md, "Exit codes").
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::InstanceName { .. }
            | Self::RootPath { .. }
            | Self::RootPathTooLong { .. }
            | Self::NotOurs { .. }
            | Self::ForeignDirectory { .. }
            | Self::SettingsDiffer { .. }
            | Self::TooMuch { .. } => USAGE,
            Self::RealtimeRefused { .. } => NO_REAL_TIME,
            Self::Occupied { .. }
            | Self::Orphaned { .. }
            | Self::Held { .. }
            | Self::Crowded { .. }
            | Self::Incompatible { .. } => OCCUPIED,
            Self::Interrupted => INTERRUPTED,
            Self::SharedMemoryFull { .. }
            | Self::UsedUp { .. }
            | Self::Wire { .. }
            | Self::Absent { .. }
            | Self::TooLate { .. }
            | Self::Panicked { .. }
            | Self::System { .. } => FAILED,
        }
    }

    #[must_use]
    pub fn remedy(&self) -> Option<String> {
        Some(match self {
            Self::InstanceName { .. } => "for example: --instance left-rig".into(),
            Self::RootPath { source, .. } => shortage::remedy(source).unwrap_or_else(|| {
                "make it a directory that you can write, or name another one in IRONBIRD_ROOT".into()
            }),
            Self::RootPathTooLong { .. } => "name a shorter one in IRONBIRD_ROOT".into(),
            Self::NotOurs { .. } => {
                "remove it, or take write permission from others (chmod go-w), or name a directory of your own in \
                 IRONBIRD_ROOT"
                    .into()
            }
            Self::ForeignDirectory { .. } => {
                "choose another --instance, or name another directory in IRONBIRD_ROOT; ironbird removes nothing there"
                    .into()
            }
            Self::Held { path, .. } => format!("`fuser -v {}` names the process", path.display()),
            Self::UsedUp { remedy, .. } => remedy.clone(),
            Self::Occupied { instance, .. } => {
                format!("wait for its end, or fly beside it under another name: --instance {instance}-2")
            }
            Self::Orphaned { path, .. } => format!("`fuser -v {}` names it: end it", path.display()),
            Self::Crowded { .. } => "end one of the others: an `ironbird watch` or an `ironbird bridge`".into(),
            Self::SettingsDiffer { laws, .. } => {
                let same = "start every role with the same --config, --trajectory, --preset, --duration and --fault";
                if laws.is_empty() { same.into() } else { format!("{same}, and like the plant with {laws}") }
            }
            Self::RealtimeRefused { remedy, .. } => remedy.clone(),
            Self::SharedMemoryFull { path, .. } => format!(
                "remove what fills it (`ironbird clean` removes leftovers of ours), or enlarge it: \
                 mount -o remount,size=256M {}",
                path.display()
            ),
            Self::Incompatible { .. } => {
                "another build of ironbird left it or still runs: end that one, then `ironbird clean`".into()
            }
            Self::Wire { .. } => "`ironbird clean` removes leftovers of killed processes".into(),
            Self::System { source, .. } => return shortage::remedy(source),
            Self::Absent { .. }
            | Self::TooLate { .. }
            | Self::TooMuch { .. }
            | Self::Panicked { .. }
            | Self::Interrupted => return None,
        })
    }

    /// A middleware error with what was tried, or what the system has run out of.
    pub fn wire(what: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        match shortage([Path::new(SHARED_MEMORY)]) {
            Some(Shortage { used_up, remedy }) => Self::UsedUp {
                what: what.into(),
                used_up,
                remedy,
            },
            None => Self::Wire {
                what: what.into(),
                reason: format!("{reason:?}"),
            },
        }
    }

    /// A failed system call with what was tried.
    pub fn system(what: impl Into<String>, source: impl Into<io::Error>) -> Self {
        Self::System {
            what: what.into(),
            source: source.into(),
        }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let failure = Self::new(error.exit_code(), error.to_string());
        match error.remedy() {
            Some(remedy) => failure.help(remedy),
            None => failure,
        }
    }
}

fn listed(names: &[String]) -> String {
    const SHOWN: usize = 3;
    let shown = names
        .iter()
        .take(SHOWN)
        .map(|name| format!("`{name}`"))
        .collect::<Vec<_>>()
        .join(", ");
    match names.len() {
        0 | 1 => format!("lies {shown}"),
        2..=SHOWN => format!("lie {shown}"),
        all => format!("lie {shown} and {} more", all - SHOWN),
    }
}

fn process(pid: Option<u32>) -> String {
    pid.map_or_else(String::new, |pid| format!(" (process {pid})"))
}
