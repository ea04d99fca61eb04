//! Locks: who plays which role, who uses the shared memory, who is at the door.
//!
//! The door is the instance's directory.
//!
//! ```text
//!   the directory     exclusive   for the instant in which a lock is taken, or leftovers are removed
//!   ROLE.lock         exclusive   as long as the process plays the role; holds its process number. Of channels b and c:
//!                                 b.ROLE.lock, c.ROLE.lock
//!   in_use.lock       shared      as long as the process uses the shared memory
//!   the root          shared      as long as the process uses the shared memory: systemd-tmpfiles then leaves it alone
//! ```
//!
//! If the directory is removed nevertheless, the page of wake-up events, which lies in the shared memory and is locked too,
//! shows that the shared memory is in use.
//!
//! Locks are `flock`s: the kernel releases them when a process dies, however it dies. A child that was forked from the
//! process, by code of a law say, does not share them ([`Locked`]).

use std::fs::{DirBuilder, File};
use std::io::{self, Read as _, Seek as _, Write as _};
use std::os::fd::AsFd;
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use errors::{Failure, OCCUPIED};
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};

use super::directory::{Directory, PRIVATE_DIRECTORY, is_at};
use super::{Instance, MARK, WAKE_EVENTS, shared_memory};
use crate::error::{Error, remedy_of};
use crate::sys::Locked;
use messages::role::{MOST_CHANNELS, Replica};

/// Name of the lock that all processes share which use the shared memory.
pub(super) const IN_USE: &str = "in_use";
pub(super) const LAUNCHER: &str = "fly";

/// How often a lock is tried before it counts as held, and how far apart.
const LOCK_TRIES: u32 = 20;
const LOCK_RETRY: Duration = Duration::from_millis(5);
/// How long a lock that is held for instants only may be waited for.
const LOCK_TIMEOUT: Duration = Duration::from_secs(5);
const LOOK_EVERY: Duration = Duration::from_millis(1);

#[derive(Debug)]
pub struct Lock {
    file: Locked,
    path: PathBuf,
    _root: Option<Directory>,
}

impl Lock {
    fn keep(file: File, path: &Path) -> Result<Self, Error> {
        let failed = |e| Error::system(format!("cannot keep the lock {}", path.display()), e);
        Ok(Self {
            file: Locked::new(file).map_err(failed)?,
            path: path.to_owned(),
            _root: None,
        })
    }

    /// Whether its file is where others look for it: another program may have removed it, with the directory.
    pub fn is_in_place(&self) -> bool {
        is_at(&self.file, &self.path)
    }
}

/// The directory of an instance, in which no other process takes a lock or removes anything while this lives.
#[derive(Debug)]
pub(super) struct Door {
    pub(super) directory: Directory,
}

impl Instance {
    pub fn prepare(&self) -> Result<(), Error> {
        self.door().map(drop)
    }

    pub fn lock(&self, role: impl Into<Replica>) -> Result<Lock, Error> {
        self.lock_as(&role.into().to_string())
    }

    /// Takes the launcher's lock: one `fly` an instance.
    pub fn lock_launcher(&self) -> Result<Lock, Error> {
        self.lock_as(LAUNCHER)
    }

    fn lock_as(&self, role: &str) -> Result<Lock, Error> {
        let path = self.lock_path(role);
        let root_path = |source| Error::path(&path, source);
        // While this process holds the directory, the file stays.
        let door = self.door()?;
        let mut file = door.directory.file_or_new(&lock_name(role))?;
        if !try_lock(&file, &path)? {
            let pid = written_pid(&path);
            let Some(pid) = pid.filter(|pid| has_ended(*pid)) else {
                return Err(self.occupied(role, pid).into());
            };
            let what = format!(
                "instance `{}`: its {role} (process {pid}) has ended, but a process that it left keeps its lock",
                self.name()
            );
            let remedy = format!("`fuser -v {}` names it: end it", path.display());
            return Err(Failure::new(OCCUPIED, what).help(remedy).into());
        }
        file.set_len(0)
            .and_then(|()| file.rewind())
            .map_err(root_path)?;
        writeln!(file, "{}", std::process::id()).map_err(root_path)?;
        Lock::keep(file, &path)
    }

    /// The error of a role that a process plays; which one is not known before it has written its number.
    fn occupied(&self, role: &str, pid: Option<u32>) -> Failure {
        let (name, by) = (
            self.name(),
            pid.map_or_else(String::new, |pid| format!(" (process {pid})")),
        );
        let what = format!("instance `{name}` already has a running {role}{by}");
        Failure::new(OCCUPIED, what).help(format!(
            "wait for its end, or fly beside it under another name: --instance {name}-2"
        ))
    }

    /// Comes to use the instance's shared memory: [`Self::remove_leftovers`] leaves it alone until this is dropped.
    ///
    /// The first to come finds it empty: what dead processes left in it is removed.
    pub fn enter(&self) -> Result<Lock, Error> {
        let door = self.door()?;
        let file = door.directory.file_or_new(&lock_name(IN_USE))?;
        let path = self.lock_path(IN_USE);
        if lock_if_free(&file, FlockOperation::NonBlockingLockExclusive, &path)? {
            if self.is_memory_used()? {
                let directory = self.directory();
                let role = format!("flight, whose {} was removed", directory.display());
                return Err(self.occupied(&role, None).into());
            }
            self.remove_memory(&door)?;
        }
        // Only a process that holds the directory has it exclusively.
        lock_soon(&file, FlockOperation::NonBlockingLockShared, &path)?;
        let lock = Lock::keep(file, &path)?;
        let root = Directory::open(&self.root)?;
        // If it is refused, only cleaners of /tmp are not held off.
        let _ = root
            .as_ref()
            .map(|it| flock(it, FlockOperation::NonBlockingLockShared));
        Ok(Lock {
            _root: root,
            ..lock
        })
    }

    /// Whether a process has the page of wake-up events, which no removal of a directory takes away.
    pub(super) fn is_memory_used(&self) -> Result<bool, Error> {
        let name = format!("{}{WAKE_EVENTS}", self.prefix());
        match shared_memory()?.map_or(Ok(None), |memory| memory.file(&name)) {
            Ok(Some(page)) => try_lock(&page, Path::new(&name)).map(|is_free| !is_free),
            // What is not ours is refused where it is used.
            Ok(None) | Err(Error::NotOurs { .. }) => Ok(false),
            Err(Error::RootPath { source, .. }) if remedy_of(&source).is_none() => Ok(false),
            Err(e) => Err(e),
        }
    }

    /// Whether a process plays the role now; if that cannot be read for lack of file descriptors, one does.
    pub fn is_occupied(&self, role: impl Into<Replica>) -> bool {
        is_or_may_be(self.look_for(role))
    }

    pub fn look_for(&self, role: impl Into<Replica>) -> Result<bool, Error> {
        self.is_held(&role.into().to_string())
    }

    /// Process number of the process that plays the role; `None` if no process does, or has not written its number yet.
    ///
    /// For an instant it may be the number of the role's previous process: never send a signal to it.
    pub fn pid_of(&self, role: impl Into<Replica>) -> Option<u32> {
        let replica = role.into();
        written_pid(&self.lock_path(&replica.to_string())).filter(|_| self.is_occupied(replica))
    }

    pub fn is_alive(&self) -> bool {
        is_or_may_be(self.is_held(LAUNCHER))
            || Replica::all(MOST_CHANNELS).any(|replica| self.is_occupied(replica))
    }

    fn is_held(&self, role: &str) -> Result<bool, Error> {
        let path = self.lock_path(role);
        match open_for_reading(&path) {
            Ok(file) => lock_if_free(&file, FlockOperation::NonBlockingLockShared, &path)
                .map(|is_free| !is_free),
            // The role was never locked.
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(source) => Err(Error::path(path, source)),
        }
    }

    fn lock_path(&self, role: &str) -> PathBuf {
        self.directory().join(lock_name(role))
    }

    /// Goes to the door of its directory, which is made where it is not there.
    pub(super) fn door(&self) -> Result<Door, Error> {
        loop {
            self.make()?;
            if let Some(door) = self.wait_at_door()? {
                self.claim(&door)?;
                return Ok(door);
            }
        }
    }

    /// Goes to the door of its directory where there is one that we have made.
    pub(super) fn door_of_ours(&self) -> Result<Option<Door>, Error> {
        loop {
            match Directory::open(&self.directory()) {
                Ok(Some(directory)) if is_ours(&directory) => {}
                Ok(_) | Err(_) => return Ok(None),
            }
            if let Some(door) = self.wait_at_door()? {
                return Ok(Some(door).filter(|door| is_marked(&door.directory)));
            }
        }
    }

    /// `None` where the directory has gone meanwhile.
    fn wait_at_door(&self) -> Result<Option<Door>, Error> {
        let path = self.directory();
        let Some(directory) = Directory::open(&path)? else {
            return Ok(None);
        };
        // Before the lock: another user's directory may be locked for ever.
        directory.check_private()?;
        lock_soon(&directory, FlockOperation::NonBlockingLockExclusive, &path)?;
        Ok(is_at(&directory, &path).then_some(Door { directory }))
    }

    fn make(&self) -> Result<(), Error> {
        let path = self.directory();
        let failed = |source| Error::path(&path, source);
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(&self.root)
            .map_err(failed)?;
        if let Some(root) = Directory::open(&self.root)? {
            root.check_root()?;
            match rustix::fs::mkdirat(&root, self.name(), PRIVATE_DIRECTORY) {
                Ok(()) | Err(Errno::EXIST) => {}
                Err(e) => return Err(failed(e.into())),
            }
        }
        Ok(())
    }

    /// Marks the directory as one of ours, unless it has other content.
    fn claim(&self, door: &Door) -> Result<(), Error> {
        if is_marked(&door.directory) {
            return Ok(());
        }
        let (path, name) = (self.directory(), self.name());
        let foreign = self.contents(door)?.foreign;
        if !foreign.is_empty() {
            let what = format!(
                "{} is no directory of ironbird: in it {}",
                path.display(),
                listed(&foreign)
            );
            return Err(Failure::usage(what)
                .help(
                    "choose another --instance, or name another directory in IRONBIRD_ROOT; ironbird removes nothing \
                     there",
                )
                .into());
        }
        door.directory.make_private()?;
        let Some(mut mark) = door.directory.new_file(MARK)? else {
            return Ok(());
        };
        let text = format!(
            "A directory of ironbird, which removes it when the instance `{name}` has ended."
        );
        writeln!(mark, "{text}").map_err(|source| Error::path(path.join(MARK), source))
    }
}

fn listed(paths: &[PathBuf]) -> String {
    const MOST: usize = 3;
    let first = paths.iter().take(MOST);
    let first = first.map(|path| format!("`{}`", path.display()));
    let first = first.collect::<Vec<_>>().join(", ");
    match paths.len() {
        0 | 1 => format!("lies {first}"),
        2..=MOST => format!("lie {first}"),
        all => format!("lie {first} and {} more", all - MOST),
    }
}

/// A role is not given up, and nothing is removed, because this process has run out of something, or the system cannot
/// tell whether a lock that is there is held.
fn is_or_may_be(held: Result<bool, Error>) -> bool {
    held.unwrap_or_else(|error| match error {
        Error::RootPath { source, .. } => remedy_of(&source).is_some(),
        _ => true,
    })
}

/// Whether ironbird made a directory, and others may not write it.
pub(super) fn is_ours(directory: &Directory) -> bool {
    directory.check_private().is_ok() && is_marked(directory)
}

pub(super) fn is_marked(directory: &Directory) -> bool {
    directory.file(MARK).is_ok_and(|mark| mark.is_some())
}

pub(super) fn lock_name(role: &str) -> String {
    format!("{role}.lock")
}

/// Takes a lock that others hold for instants only.
pub(crate) fn lock_soon(
    file: impl AsFd,
    operation: FlockOperation,
    path: &Path,
) -> Result<(), Error> {
    let start = Instant::now();
    while !lock_if_free(&file, operation, path)? {
        if start.elapsed() >= LOCK_TIMEOUT {
            let (path, seconds) = (path.display(), LOCK_TIMEOUT.as_secs());
            let what = format!("another process has locked {path} for {seconds} s");
            let remedy = format!("`fuser -v {path}` names the process");
            return Err(Failure::new(OCCUPIED, what).help(remedy).into());
        }
        std::thread::sleep(LOOK_EVERY);
    }
    Ok(())
}

/// Takes the lock, through the instants in which another process checks whether it is held; returns whether it was free.
pub(super) fn try_lock(file: &File, path: &Path) -> Result<bool, Error> {
    for attempt in 0..LOCK_TRIES {
        if attempt > 0 {
            std::thread::sleep(LOCK_RETRY);
        }
        if lock_if_free(file, FlockOperation::NonBlockingLockExclusive, path)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Takes a lock if it is free; returns whether it was.
///
/// Only one answer of the system means that the lock is held. Other errors, such as no memory for locks, do not.
fn lock_if_free(file: impl AsFd, operation: FlockOperation, path: &Path) -> Result<bool, Error> {
    loop {
        match flock(&file, operation) {
            Ok(()) => return Ok(true),
            Err(Errno::WOULDBLOCK) => return Ok(false),
            Err(Errno::INTR) => {}
            Err(e) => return Err(Error::system(format!("cannot lock {}", path.display()), e)),
        }
    }
}

/// What the last holder of a lock wrote; nothing in the instant between locking and writing.
fn written_pid(path: &Path) -> Option<u32> {
    let text = io::read_to_string(open_for_reading(path).ok()?.take(32));
    text.ok()?.trim().parse().ok()
}

fn has_ended(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) == Err(Errno::SRCH))
}

fn open_for_reading(path: &Path) -> io::Result<File> {
    let safely = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    File::options()
        .read(true)
        .custom_flags(safely.bits().cast_signed())
        .open(path)
}
