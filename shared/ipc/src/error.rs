//! What can go wrong outside the laws, and what to do about each error.

use std::path::{Path, PathBuf};
use std::{fs, io};

use errors::{FAILED, Failure, INTERRUPTED, OCCUPIED, USAGE};
use rustix::fs::{StatVfs, StatVfsMountFlags, statvfs};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};
use thiserror::Error;

/// Why a process of the rig cannot go on. What a caller tells apart has a variant.
#[derive(Debug, Error)]
pub enum Error {
    /// The directory for sockets and service files, or something in it or in shared memory, cannot be used.
    #[error("cannot use {}: {source}", path.display())]
    RootPath { path: PathBuf, source: io::Error },
    /// A file or directory belongs to another user, or can be written by others.
    #[error("{} is not used: {why}", path.display())]
    NotOurs { path: PathBuf, why: String },
    #[error("{what}: iceoryx2 says {reason}")]
    Wire { what: String, reason: String },
    /// Shared memory was left by another build.
    #[error("{what} exists with an incompatible layout: iceoryx2 says {reason}")]
    Incompatible { what: String, reason: String },
    /// Ended by a signal before the run began.
    #[error("interrupted")]
    Interrupted,
    #[error("{0}")]
    Other(#[from] Failure),
}

impl Error {
    /// Exit code of a process that ends with this error (docs/architecture.md, "Exit codes").
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::RootPath { .. } | Self::NotOurs { .. } => USAGE,
            Self::Incompatible { .. } => OCCUPIED,
            Self::Interrupted => INTERRUPTED,
            Self::Wire { .. } => FAILED,
            Self::Other(failure) => failure.code,
        }
    }

    pub fn remedy(&self) -> Option<String> {
        Some(match self {
            Self::RootPath { source, .. } => remedy_of(source).unwrap_or_else(|| {
                "make it a directory that you can write, or name another one in IRONBIRD_ROOT".into()
            }),
            Self::NotOurs { .. } => {
                "remove it, or take write permission from others (chmod go-w), or name a directory of your own in \
                 IRONBIRD_ROOT"
                    .into()
            }
            Self::Incompatible { .. } => {
                "another build of ironbird left it or still runs: end that one, then `ironbird clean`".into()
            }
            Self::Wire { .. } => "`ironbird clean` removes leftovers of killed processes".into(),
            Self::Other(failure) => return failure.remedy().map(str::to_owned),
            Self::Interrupted => return None,
        })
    }

    pub fn failed(what: impl Into<String>) -> Self {
        Failure::failed(what).into()
    }

    pub fn usage(what: impl Into<String>) -> Self {
        Failure::usage(what).into()
    }

    /// A middleware error with what was tried, or what the system has run out of.
    pub fn wire(what: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        let shortage = shortage([Path::new(SHARED_MEMORY)]);
        Self::of_middleware(what.into(), format!("{reason:?}"), shortage)
    }

    pub(crate) fn of_middleware(what: String, reason: String, shortage: Option<Shortage>) -> Self {
        match shortage {
            Some(Shortage { used_up, remedy }) => Failure::failed(format!("{what}: {used_up}"))
                .help(remedy)
                .into(),
            None => Self::Wire { what, reason },
        }
    }

    /// Something in the file system that cannot be used.
    pub(crate) fn path(path: impl Into<PathBuf>, source: impl Into<io::Error>) -> Self {
        Self::RootPath {
            path: path.into(),
            source: source.into(),
        }
    }

    /// A failed system call with what was tried.
    pub fn system(what: impl Into<String>, source: impl Into<io::Error>) -> Self {
        let (what, source) = (what.into(), source.into());
        let failure = Failure::failed(format!("{what}: {source}"));
        Self::Other(match remedy_of(&source) {
            Some(remedy) => failure.help(remedy),
            None => failure,
        })
    }
}

pub(crate) trait Tried<T> {
    fn wire(self, what: impl FnOnce() -> String) -> Result<T, Error>;
}

impl<T, E: std::fmt::Debug> Tried<T> for Result<T, E> {
    fn wire(self, what: impl FnOnce() -> String) -> Result<T, Error> {
        self.map_err(|error| Error::wire(what(), error))
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        if let Error::Other(failure) = error {
            return failure;
        }
        let failure = Self::new(error.exit_code(), error.to_string());
        match error.remedy() {
            Some(remedy) => failure.help(remedy),
            None => failure,
        }
    }
}

/// Why the middleware did not open a service.
pub(crate) struct Refusal {
    pub(crate) kind: RefusalKind,
    pub(crate) reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RefusalKind {
    /// Another process is creating or removing the service, or a signal came: try again.
    Passing,
    /// Another build has created it.
    Differs,
    Lasting,
}

impl Refusal {
    /// The middleware has an error type per kind of service and call, with the same names of variants in all of them.
    /// Some hold an error of another type: `PublishSubscribeOpenError(IncompatibleTypes)`.
    pub(crate) fn of(error: impl std::fmt::Debug) -> Self {
        let reason = format!("{error:?}");
        let name = reason.rsplit('(').next().unwrap_or(&reason);
        let reason = name.trim_end_matches(')').to_owned();
        let kind = match reason.as_str() {
            "Interrupt"
            | "DoesNotExist"
            | "ServiceInCorruptedState"
            | "HangsInCreation"
            | "IsMarkedForDestruction"
            | "IsBeingCreatedByAnotherInstance"
            | "SystemInFlux" => RefusalKind::Passing,
            "VersionMismatch" => RefusalKind::Differs,
            other if other.starts_with("Incompatible") => RefusalKind::Differs,
            other if other.starts_with("DoesNotSupportRequested") => RefusalKind::Differs,
            _ => RefusalKind::Lasting,
        };
        Self { kind, reason }
    }
}

/// Where Linux keeps POSIX shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Files that opening one service may take, and room for them [bytes]. What failed for want of the last one has given
/// the others back.
const FILES_OF_A_SERVICE: u64 = 8;
const ROOM_OF_A_SERVICE: u64 = 1 << 20;

/// More than the longest file of shared memory has [bytes].
const FILE_BYTES: u64 = 16 << 20;

const MORE_FILES: &str = "raise the limit before the start: ulimit -n 1024";

pub(crate) struct Shortage {
    pub(crate) used_up: String,
    pub(crate) remedy: String,
}

/// What this process has too little of to open a service, whose files lie in a directory and in shared memory.
pub(crate) fn shortage<'a>(places: impl IntoIterator<Item = &'a Path>) -> Option<Shortage> {
    let of_room = |place: &Path| lack_of_room(place, &statvfs(place).ok()?);
    of_files()
        .or_else(of_length)
        .or_else(|| places.into_iter().find_map(of_room))
}

/// The remedy where the system itself says that something is used up.
pub(crate) fn remedy_of(error: &io::Error) -> Option<String> {
    match Errno::from_io_error(error)? {
        Errno::MFILE => Some(MORE_FILES.into()),
        Errno::NFILE => {
            Some("end other processes, or raise the limit of the system: sysctl fs.file-max".into())
        }
        Errno::NOSPC | Errno::DQUOT => {
            Some("remove what fills the file system, or enlarge it".into())
        }
        _ => None,
    }
}

fn of_files() -> Option<Shortage> {
    let limit = getrlimit(Resource::Nofile).current?;
    let open = match fs::read_dir("/proc/self/fd") {
        Ok(entries) => entries.count() as u64,
        Err(e) if Errno::from_io_error(&e) == Some(Errno::MFILE) => limit,
        Err(_) => return None,
    };
    (open + FILES_OF_A_SERVICE > limit).then(|| Shortage {
        used_up: format!(
            "too many open files: {open} of the {limit} that this process may have (ulimit -n)"
        ),
        remedy: MORE_FILES.into(),
    })
}

/// Shared memory is made of files, whose length the user's limit holds for.
fn of_length() -> Option<Shortage> {
    let limit = getrlimit(Resource::Fsize)
        .current
        .filter(|limit| *limit < FILE_BYTES)?;
    let kib = limit >> 10;
    Some(Shortage {
        used_up: format!("a file of shared memory may have {kib} KiB in this process (ulimit -f)"),
        remedy: "raise the limit before the start: ulimit -f unlimited".into(),
    })
}

fn lack_of_room(place: &Path, system: &StatVfs) -> Option<Shortage> {
    let place = place.display();
    let free = system.f_bavail * system.f_frsize;
    let (used_up, remedy) = if system.f_flag.contains(StatVfsMountFlags::RDONLY) {
        (
            format!("the file system of {place} is mounted read-only"),
            format!("mount it writable: mount -o remount,rw {place}"),
        )
    // Some file systems count no inodes.
    } else if system.f_files > 0 && system.f_favail < FILES_OF_A_SERVICE {
        let inodes = system.f_favail;
        (
            format!("too few inodes are left on the file system of {place}: {inodes}"),
            format!("remove files from it, or give it more inodes: df -i {place}"),
        )
    } else if free < ROOM_OF_A_SERVICE {
        let kib = free >> 10;
        (
            format!("too little space is left on the file system of {place}: {kib} KiB"),
            format!("remove what fills it, or enlarge it: df -h {place}"),
        )
    } else {
        return None;
    };
    Some(Shortage { used_up, remedy })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_only_file_system_gets_the_advice_to_mount_it_writable() {
        let place = Path::new(SHARED_MEMORY);
        let mut system = statvfs("/proc").unwrap();
        (system.f_files, system.f_bavail, system.f_frsize) = (0, 1 << 20, 4096);
        system.f_flag = StatVfsMountFlags::empty();
        assert!(lack_of_room(place, &system).is_none());
        system.f_flag = StatVfsMountFlags::RDONLY;
        let Shortage { used_up, remedy } = lack_of_room(place, &system).unwrap();
        assert_eq!(used_up, "the file system of /dev/shm is mounted read-only");
        assert!(remedy.contains("remount,rw /dev/shm"), "{remedy}");
    }
}
