//! An instance of the rig: its name, directory, locks and part of shared memory.
//!
//! Everything that an instance leaves in the file system carries its name. Two instances can therefore fly side by
//! side, and the leftovers of a killed one can be found and removed. The submodules: `root` says where instances live,
//! `locks` which processes live, `leftovers` what may be removed, `directory` what is safe to open.

mod directory;
mod leftovers;
mod locks;
mod root;

use std::io;
use std::path::{Path, PathBuf};

use iceoryx2::prelude::{Config, FileName, SemanticString as _};

pub use locks::Lock;
pub use root::{ROOT_VARIABLE, root_path};

pub use crate::error::SHARED_MEMORY;

pub(crate) use directory::is_at;
pub(crate) use locks::lock_soon;

use crate::error::Error;
use directory::Directory;
use errors::Failure;
use messages::layout::{FNV_OFFSET, fnv1a};
use root::ROOT_MAX;

const MIB: u64 = 1 << 20;
const NAME_MAX: usize = 32;
/// The file that says that we have made a directory. Without it, nothing in a directory is ever removed.
const MARK: &str = ".ironbird";
/// End of the name of the page of wake-up events in shared memory.
pub(crate) const WAKE_EVENTS: &str = "wake_events";

pub type Name = heapless::String<NAME_MAX>;

#[derive(Clone, Debug)]
pub struct Instance {
    name: Name,
    /// Under its one spelling, so that one directory is one instance however it is named.
    root: PathBuf,
}

impl Instance {
    /// The instance of a name under the root path of the environment.
    pub fn new(name: &str) -> Result<Self, Error> {
        let name = allowed(name)?;
        Ok(Self {
            name,
            root: short(root::root()?)?,
        })
    }

    /// The instance of a name under a root path of the caller's choice.
    pub fn under(root: &Path, name: &str) -> Result<Self, Error> {
        let name = allowed(name)?;
        Ok(Self {
            name,
            root: short(root::one_spelling(root)?)?,
        })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn directory(&self) -> PathBuf {
        self.root.join(self.name())
    }

    /// Start of the names of its segments in shared memory.
    ///
    /// It carries a hash of the root path, so that instances of one name under two roots stay apart, and ends with
    /// a character that no name has, so that it never begins another instance's.
    pub fn prefix(&self) -> String {
        format!("{}{}.", Self::prefix_of_root(&self.root), self.name())
    }

    /// The same as far as all instances under this process' root share it.
    pub fn root_prefix() -> Result<String, Error> {
        Ok(Self::prefix_of_root(&short(root::root()?)?))
    }

    /// The same as far as all instances under one root share it.
    fn prefix_of_root(root: &Path) -> String {
        let hash = fnv1a(FNV_OFFSET, root.as_os_str().as_encoded_bytes());
        format!("ironbird_{:08x}_", hash & 0xffff_ffff)
    }

    /// Free space in shared memory against what the instance needs beside what it has already.
    pub fn check_shared_memory(&self, needed_bytes: u64) -> Result<(), Error> {
        // In this order: what another role takes meanwhile is rather counted as had than as wanted.
        let free = shared_memory_space()?;
        let needed = needed_bytes.saturating_sub(self.owned_bytes());
        if free >= needed {
            return Ok(());
        }
        let (free_mib, needed_mib) = (free / MIB, needed.div_ceil(MIB));
        let what = format!(
            "shared memory is too small: {SHARED_MEMORY} has {free_mib} MiB free, this instance needs {needed_mib} MiB"
        );
        Err(Failure::failed(what)
            .help(format!(
                "remove what fills it (`ironbird clean` removes leftovers of ours), or enlarge it: \
                 mount -o remount,size=256M {SHARED_MEMORY}; in a container: docker run --shm-size=256m, or podman run \
                 likewise"
            ))
            .into())
    }

    /// The middleware's configuration; a configuration file in the working directory is ignored.
    pub fn config(&self) -> Result<Config, Error> {
        let directory = self.directory();
        let invalid = |what: &str| {
            Error::path(
                &directory,
                io::Error::new(io::ErrorKind::InvalidInput, what),
            )
        };
        let mut config = Config::default();
        let path = iceoryx2::prelude::Path::new(directory.as_os_str().as_encoded_bytes())
            .map_err(|_| invalid("not a path that iceoryx2 can use"))?;
        config.global.set_root_path(&path);
        config.global.prefix = FileName::new(self.prefix().as_bytes())
            .map_err(|_| invalid("not a name that iceoryx2 can use"))?;
        // Dead nodes are reaped where it cannot touch the control path: by `Wire::open`, before any port exists.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(config)
    }
}

pub fn shared_memory_space() -> Result<u64, Error> {
    rustix::fs::statvfs(SHARED_MEMORY)
        .map(|stat| stat.f_bavail * stat.f_frsize)
        .map_err(|e| Error::system(format!("cannot look at {SHARED_MEMORY}"), e))
}

/// The directory of shared memory, which on some systems the system itself reaches through a link.
pub(crate) fn shared_memory() -> Result<Option<Directory>, Error> {
    let path = Path::new(SHARED_MEMORY)
        .canonicalize()
        .unwrap_or_else(|_| PathBuf::from(SHARED_MEMORY));
    Directory::open(&path)
}

fn allowed(name: &str) -> Result<Name, Error> {
    let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_' || c == '-';
    let valid = !name.is_empty() && !name.starts_with('-') && name.chars().all(allowed);
    let refused = || {
        let allowed = "1 to 32 of the characters a-z, 0-9, `_` and `-`, not beginning with `-`";
        let what = format!("instance name `{name}` is not allowed: {allowed}");
        Failure::usage(what).help("for example: --instance left-rig")
    };
    let name = Name::try_from(name).ok().filter(|_| valid);
    Ok(name.ok_or_else(refused)?)
}

fn short(root: PathBuf) -> Result<PathBuf, Error> {
    let length = root.as_os_str().len();
    if length > ROOT_MAX {
        let what = format!(
            "the root path {} is {length} characters long; iceoryx2's paths below it need it to be at most {ROOT_MAX}",
            root.display()
        );
        return Err(Failure::usage(what)
            .help("name a shorter one in IRONBIRD_ROOT")
            .into());
    }
    Ok(root)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_files_cannot_carry_are_refused() {
        for name in [
            "",
            "A",
            "left rig",
            "../up",
            "ä",
            "x234567890123456789012345678901234",
        ] {
            let error = Instance::new(name).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(&format!("`{name}`")), "{error}");
        }
        assert_eq!(Instance::new("left-rig_2").unwrap().name(), "left-rig_2");
    }
}
