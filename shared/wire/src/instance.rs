//! An instance of the rig: its name, directory, locks and part of shared memory.
//!
//! Everything that an instance leaves in the file system carries its name. Two instances can therefore fly side by
//! side, and the leftovers of a killed one can be found and removed. Locks are `flock`s: the kernel releases them when
//! a process dies, however it dies.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use iceoryx2::prelude::{Config, FileName, SemanticString as _};
use rustix::fs::{FlockOperation, flock};

use crate::error::Error;
use model::layout::{FNV_OFFSET, fnv1a};
use model::role::{ROLES, Role};

/// Names the directory under which instances keep their sockets and service files.
pub const ROOT_VARIABLE: &str = "IRONBIRD_ROOT";

/// Longest name of an instance.
const NAME_MAX: usize = 32;
/// What a socket's name below the root may need: `sockaddr_un` holds 108 bytes.
const ROOT_MAX: usize = 40;

/// Name of the lock that all users of the shared memory share.
const IN_USE: &str = "in_use";

/// How often a lock is tried before it counts as held, and how far apart.
const LOCK_TRIES: u32 = 20;
const LOCK_RETRY: Duration = Duration::from_millis(5);

/// Capacity of an instance's name.
pub type Name = heapless::String<NAME_MAX>;

/// A named instance of the rig.
#[derive(Clone, Debug)]
pub struct Instance {
    name: Name,
    root: PathBuf,
}

/// A lock that is held as long as this lives.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

impl Instance {
    /// The instance of a name under the root path of the environment.
    ///
    /// # Errors
    /// [`Error::InstanceName`], [`Error::RootPathTooLong`].
    pub fn new(name: &str) -> Result<Self, Error> {
        Self::under(&root_path(), name)
    }

    /// The instance of a name under a root path of the caller's choice.
    ///
    /// # Errors
    /// [`Error::InstanceName`], [`Error::RootPathTooLong`].
    pub fn under(root: &Path, name: &str) -> Result<Self, Error> {
        let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
        let valid = !name.is_empty() && name.chars().all(allowed);
        let name =
            Name::try_from(name).ok().filter(|_| valid).ok_or_else(|| Error::InstanceName { name: name.to_owned() })?;
        let length = root.as_os_str().len();
        if length > ROOT_MAX {
            return Err(Error::RootPathTooLong { path: root.to_owned(), length, max: ROOT_MAX });
        }
        Ok(Self { name, root: root.to_owned() })
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its directory.
    #[must_use]
    pub fn directory(&self) -> PathBuf {
        self.root.join(self.name())
    }

    /// Makes its directory, readable by its owner alone.
    ///
    /// # Errors
    /// [`Error::RootPath`].
    pub fn prepare(&self) -> Result<(), Error> {
        let directory = self.directory();
        let make = || {
            fs::DirBuilder::new().recursive(true).mode(0o750).create(&directory)?;
            try_to_write(&directory)
        };
        make().map_err(|source| Error::RootPath { path: directory.clone(), source })
    }

    /// Takes the lock of a role.
    ///
    /// # Errors
    /// [`Error::Occupied`] names the process that holds it.
    pub fn lock(&self, role: Role) -> Result<Lock, Error> {
        self.lock_as(role.name())
    }

    /// Takes the launcher's lock: one `fly` an instance.
    ///
    /// # Errors
    /// [`Error::Occupied`] names the process that holds it.
    pub fn lock_launcher(&self) -> Result<Lock, Error> {
        self.lock_as("fly")
    }

    /// Registers as a user of the shared memory: [`Self::remove_leftovers`] spares it until the lock is dropped.
    ///
    /// # Errors
    /// [`Error::RootPath`].
    pub fn enter(&self) -> Result<Lock, Error> {
        let path = self.lock_path(IN_USE);
        let root_path = |source| Error::RootPath { path: path.clone(), source };
        loop {
            self.prepare()?;
            let file = match open_lock(&path) {
                // Removed between the two.
                Err(e) if e.kind() == io::ErrorKind::NotFound => continue,
                file => file.map_err(root_path)?,
            };
            // Waits while somebody removes leftovers, this file among them.
            flock(&file, FlockOperation::LockShared).map_err(|e| root_path(e.into()))?;
            if is_at(&file, &path) {
                return Ok(Lock { _file: file });
            }
        }
    }

    fn lock_as(&self, role: &str) -> Result<Lock, Error> {
        let path = self.lock_path(role);
        let root_path = |source| Error::RootPath { path: path.clone(), source };
        loop {
            let mut file = open_lock(&path).map_err(root_path)?;
            if !try_lock(&file) {
                let (instance, role, pid) = (self.name().into(), role.into(), written_pid(&path));
                return Err(Error::Occupied { instance, role, pid });
            }
            // Somebody may have removed the leftovers, and this file with them, before it was locked.
            if !is_at(&file, &path) {
                self.prepare()?;
                continue;
            }
            file.set_len(0).and_then(|()| file.rewind()).map_err(root_path)?;
            writeln!(file, "{}", std::process::id()).map_err(root_path)?;
            return Ok(Lock { _file: file });
        }
    }

    /// Whether a process plays the role now.
    #[must_use]
    pub fn is_occupied(&self, role: Role) -> bool {
        is_locked(&self.lock_path(role.name()))
    }

    /// Process number of the role's process; none if there is no such process or it has not written its number yet.
    #[must_use]
    pub fn pid_of(&self, role: Role) -> Option<u32> {
        written_pid(&self.lock_path(role.name())).filter(|_| self.is_occupied(role))
    }

    /// Whether any process of the instance lives.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        is_locked(&self.lock_path("fly")) || ROLES.iter().any(|role| self.is_occupied(*role))
    }

    fn lock_path(&self, role: &str) -> PathBuf {
        self.directory().join(format!("{role}.lock"))
    }

    /// Start of the names of its segments in shared memory.
    ///
    /// It carries a hash of the root path, so that instances of one name under two roots stay apart, and ends with
    /// a character that no name has, so that it never begins another instance's.
    #[must_use]
    pub fn prefix(&self) -> String {
        let hash = fnv1a(FNV_OFFSET, self.root.as_os_str().as_encoded_bytes());
        format!("ironbird_{:08x}_{}.", hash & 0xffff_ffff, self.name())
    }

    /// The middleware's configuration; a configuration file in the working directory is ignored.
    ///
    /// # Errors
    /// [`Error::RootPath`] where the directory is no valid path for the middleware.
    pub fn config(&self) -> Result<Config, Error> {
        let directory = self.directory();
        let invalid = |what: &str| Error::RootPath {
            path: directory.clone(),
            source: io::Error::new(io::ErrorKind::InvalidInput, what),
        };
        let mut config = Config::default();
        let path = iceoryx2::prelude::Path::new(directory.as_os_str().as_encoded_bytes())
            .map_err(|_| invalid("not a path that iceoryx2 can use"))?;
        config.global.set_root_path(&path);
        config.global.prefix =
            FileName::new(self.prefix().as_bytes()).map_err(|_| invalid("not a name that iceoryx2 can use"))?;
        // Dead nodes are reaped where it cannot touch the control path: by `Wire::new`, before any port exists.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(config)
    }

    /// Every instance under the root path whose plant runs now.
    #[must_use]
    pub fn flying() -> Vec<Self> {
        Self::known().into_iter().filter(|instance| instance.is_occupied(Role::Plant)).collect()
    }

    /// Every instance that has a directory under the root path, in order of name.
    #[must_use]
    pub fn known() -> Vec<Self> {
        let mut names: Vec<String> = fs::read_dir(root_path())
            .into_iter()
            .flatten()
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .collect();
        names.sort();
        names.iter().filter_map(|name| Self::new(name).ok()).collect()
    }

    /// Leftovers of the instance if none of its processes lives: segments in shared memory, then its directory.
    #[must_use]
    pub fn leftovers(&self) -> Vec<PathBuf> {
        if self.is_alive() {
            return Vec::new();
        }
        let prefix = self.prefix();
        let is_ours = |entry: &fs::DirEntry| entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes());
        let segments = fs::read_dir(SHARED_MEMORY).into_iter().flatten().filter_map(Result::ok).filter(is_ours);
        let directory = self.directory();
        segments.map(|entry| entry.path()).chain(directory.exists().then_some(directory)).collect()
    }

    /// Removes what is left of the instance if no living process uses it, and returns what it removed.
    ///
    /// # Errors
    /// [`Error::System`] names the file that could not be removed.
    pub fn remove_leftovers(&self) -> Result<Vec<PathBuf>, Error> {
        // Where nobody has entered since the last removal, there is no such file.
        let in_use = File::open(self.lock_path(IN_USE)).ok();
        if in_use.as_ref().is_some_and(|file| !try_lock(file)) {
            return Ok(Vec::new());
        }
        let leftovers = self.leftovers();
        for path in &leftovers {
            let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            removed.map_err(|e| Error::system(format!("cannot remove {}", path.display()), e))?;
        }
        Ok(leftovers)
    }
}

/// Free space in shared memory against what an instance needs.
///
/// # Errors
/// [`Error::SharedMemoryFull`] with both numbers.
pub fn check_shared_memory(needed_bytes: u64) -> Result<(), Error> {
    const MIB: u64 = 1 << 20;
    let free = shared_memory_space()?;
    if free >= needed_bytes {
        return Ok(());
    }
    let (free_mib, needed_mib) = (free / MIB, needed_bytes.div_ceil(MIB));
    Err(Error::SharedMemoryFull { path: SHARED_MEMORY.into(), free_mib, needed_mib })
}

/// Free bytes in shared memory.
///
/// # Errors
/// [`Error::System`] where it is not there.
pub fn shared_memory_space() -> Result<u64, Error> {
    rustix::fs::statvfs(SHARED_MEMORY)
        .map(|stat| stat.f_bavail * stat.f_frsize)
        .map_err(|e| Error::system(format!("cannot look at {SHARED_MEMORY}"), e))
}

/// Where Linux keeps POSIX shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// The directory under which instances live: `IRONBIRD_ROOT`, else one in /tmp that carries the user's number.
#[must_use]
pub fn root_path() -> PathBuf {
    std::env::var_os(ROOT_VARIABLE)
        .filter(|root| !root.is_empty())
        .map_or_else(|| PathBuf::from(format!("/tmp/ironbird-{}", rustix::process::getuid().as_raw())), PathBuf::from)
}

fn open_lock(path: &Path) -> io::Result<File> {
    OpenOptions::new().create(true).truncate(false).read(true).write(true).mode(0o640).open(path)
}

/// Whether a file is still the one at its path.
pub(crate) fn is_at(file: &File, path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|there| file.metadata().is_ok_and(|ours| ours.ino() == there.ino()))
}

/// Takes the lock; retries while another process briefly holds it only to check whether it is held.
fn try_lock(file: &File) -> bool {
    let mut tries = 0..LOCK_TRIES;
    tries.any(|attempt| {
        if attempt > 0 {
            std::thread::sleep(LOCK_RETRY);
        }
        flock(file, FlockOperation::NonBlockingLockExclusive).is_ok()
    })
}

/// What the last holder of a lock wrote; nothing in the instant between locking and writing.
fn written_pid(path: &Path) -> Option<u32> {
    fs::read_to_string(path).ok()?.trim().parse().ok()
}

fn is_locked(path: &Path) -> bool {
    // Opening may fail because nobody ever was there; then nobody is.
    File::open(path).is_ok_and(|file| flock(&file, FlockOperation::NonBlockingLockShared).is_err())
}

fn try_to_write(directory: &Path) -> io::Result<()> {
    static PROBES: AtomicU64 = AtomicU64::new(0);
    let number = PROBES.fetch_add(1, Ordering::Relaxed);
    let probe = directory.join(format!("probe.{}.{number}", std::process::id()));
    File::create(&probe)?;
    fs::remove_file(probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_files_cannot_carry_are_refused() {
        for name in ["", "A", "left rig", "../up", "ä", "x234567890123456789012345678901234"] {
            let error = Instance::new(name).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(&format!("`{name}`")), "{error}");
        }
        assert_eq!(Instance::new("left-rig_2").unwrap().name(), "left-rig_2");
    }
}
