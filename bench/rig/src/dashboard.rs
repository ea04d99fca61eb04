//! The dashboard beside a launcher: a process in the launcher's terminal.
//!
//! The launcher goes on when the user leaves the dashboard, and has the terminal back before it prints.

use std::path::Path;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use wire::instance::Instance;

use failure::Failure;

/// How long it may take to see the flight's end, and then to give the terminal back.
const LEAVING: Duration = Duration::from_secs(1);
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// A dashboard that is open or was.
#[derive(Debug)]
pub struct Dashboard {
    child: Child,
}

impl Dashboard {
    /// Opens it; `executable` is ironbird's own.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason.
    pub fn open(executable: &Path, instance: &Instance) -> Result<Self, Failure> {
        let child = Command::new(executable)
            .args(["watch", "--instance", instance.name(), "--launcher", &std::process::id().to_string()])
            .spawn()
            .map_err(|e| Failure::failed(format!("cannot start the dashboard: {e}")))?;
        Ok(Self { child })
    }

    /// Whether it still has the terminal.
    pub fn is_open(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Waits for its end, which the flight's end brings; tells it to end where that does not.
    pub fn close(&mut self) {
        if self.has_left() {
            return;
        }
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            // It may have ended by itself meanwhile.
            let _ = kill_process(pid, Signal::TERM);
        }
        if !self.has_left() {
            // Only a process that has ended already resists.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }

    fn has_left(&mut self) -> bool {
        let until = Instant::now() + LEAVING;
        while self.is_open() {
            if Instant::now() >= until {
                return false;
            }
            sleep(LOOK_EVERY);
        }
        true
    }
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        self.close();
    }
}
