//! An instance for one test, which leaves nothing behind.

use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ipc::Wire;
use ipc::instance::Instance;
use messages::inspection::Expected;
use tempfile::TempDir;

pub const EXPECTED: Expected = Expected {
    run_id: 7,
    settings: 9,
};
pub const EPOCH: u64 = 100;

pub struct Site {
    pub instance: Instance,
    root: TempDir,
}

impl Site {
    pub fn new() -> Self {
        // Not below TMPDIR: sockets need a short path.
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        Self {
            instance: Instance::under(root.path(), "test").unwrap(),
            root,
        }
    }

    pub fn wire(&self) -> Wire {
        Wire::open(&self.instance).unwrap()
    }

    pub fn root(&self) -> &Path {
        self.root.path()
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        remove(&self.instance);
    }
}

pub fn remove(instance: &Instance) {
    soon(|| (!instance.is_alive()).then_some(()));
    instance.remove_leftovers().unwrap();
}

/// Tries until it gets something, or a minute has passed.
///
/// A lock that was dropped lives on for an instant where another thread is starting a process.
pub fn soon<T>(mut get: impl FnMut() -> Option<T>) -> Option<T> {
    let start = Instant::now();
    loop {
        let got = get();
        if got.is_some() || start.elapsed() > Duration::from_secs(60) {
            return got;
        }
        sleep(Duration::from_millis(1));
    }
}
