//! Shared memory: where it is, and whether it has room for an instance.

use std::path::{Path, PathBuf};

use super::Instance;
use super::directory::Directory;
use crate::error::Error;
use crate::shortage::SHARED_MEMORY;

const MIB: u64 = 1 << 20;

impl Instance {
    /// Free space in shared memory against what the instance needs beside what it has already.
    pub fn check_shared_memory(&self, needed_bytes: u64) -> Result<(), Error> {
        // In this order: what another role takes meanwhile is rather counted as had than as wanted.
        let free = shared_memory_space()?;
        let needed = needed_bytes.saturating_sub(self.owned_bytes());
        if free >= needed {
            return Ok(());
        }
        let (free_mib, needed_mib) = (free / MIB, needed.div_ceil(MIB));
        Err(Error::SharedMemoryFull {
            path: SHARED_MEMORY.into(),
            free_mib,
            needed_mib,
        })
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
