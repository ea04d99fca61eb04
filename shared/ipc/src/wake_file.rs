//! The file of the wake-up events in shared memory, which the processes of an instance share.

use std::fs;
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use rustix::fs::{FallocateFlags, FlockOperation, fallocate, flock};
use rustix::io::Errno;

use crate::error::Error;
use crate::instance::{Instance, SHARED_MEMORY, WAKE_EVENTS, is_at, lock_soon, shared_memory};
use crate::sys::{EVENTS, Locked, WakePage};
use messages::layout::{FNV_OFFSET, fnv1a};

/// Token of the last event of the page, which is not used otherwise: version of the page's layout.
const MARK: u64 = fnv1a(FNV_OFFSET, b"ironbird-wake-events/4");

/// A share in the page of an instance.
///
/// ```text
///   every process: open, lock shared, map       the last one to leave: lock exclusive, remove
/// ```
#[derive(Debug)]
pub(super) struct WakeFile {
    file: Locked,
    path: PathBuf,
}

impl WakeFile {
    pub(super) fn join(instance: &Instance) -> Result<Self, Error> {
        let name = format!("{}{WAKE_EVENTS}", instance.prefix());
        let path = Path::new(SHARED_MEMORY).join(&name);
        let failed = |e| Error::system(format!("cannot make {}", path.display()), e);
        let memory = shared_memory()?.ok_or_else(|| failed(Errno::NOENT))?;
        loop {
            // Everybody can guess its name, and write in the directory.
            let file = memory.file_or_new(&name)?;
            // Held exclusively for the instant in which the last one leaves.
            lock_soon(&file, FlockOperation::NonBlockingLockShared, &path)?;
            // The last process may have left before it was locked.
            if !is_at(&file, &path) {
                continue;
            }
            // Reserved at once: if shared memory has no space for the page, reading it kills the process (SIGBUS).
            fallocate(&file, FallocateFlags::empty(), 0, WakePage::BYTES as u64).map_err(failed)?;
            let joined = Self {
                file: Locked::new(file)
                    .map_err(|e| Error::system(format!("cannot lock {}", path.display()), e))?,
                path,
            };
            joined.check_mark()?;
            return Ok(joined);
        }
    }

    fn check_mark(&self) -> Result<(), Error> {
        let mark = &self.page()?[EVENTS - 1].token;
        match mark.compare_exchange(0, MARK, Ordering::AcqRel, Ordering::Acquire) {
            Ok(_) => Ok(()),
            Err(found) if found == MARK => Ok(()),
            Err(found) => Err(Error::Incompatible {
                what: "the page of wake-up events".into(),
                reason: format!("its mark is {found:016x}, here {MARK:016x}"),
            }),
        }
    }

    pub(super) fn page(&self) -> Result<WakePage, Error> {
        WakePage::map(self.file.as_fd())
            .map_err(|e| Error::system(format!("cannot map {}", self.path.display()), e))
    }
}

impl Drop for WakeFile {
    fn drop(&mut self) {
        if flock(&self.file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            // It may have been removed as a leftover.
            let _ = fs::remove_file(&self.path);
        }
    }
}
