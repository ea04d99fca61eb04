//! The dashboard of `fly --watch`: a process in the launcher's terminal.
//!
//! The launcher goes on when the user leaves the dashboard. Before the launcher prints, the terminal is as it was, even
//! if the dashboard was killed.

use std::io;
use std::io::IsTerminal as _;
use std::path::Path;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::LeaveAlternateScreen;
use rustix::process::{Pid, Signal, getpgrp, kill_process};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};
use wire::instance::Instance;

use failure::Failure;

/// How long it may take to see the flight's end, and then to give the terminal back.
const LEAVING: Duration = Duration::from_secs(1);
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// A dashboard that is open or was.
#[derive(Debug)]
pub struct Dashboard {
    child: Child,
    /// What the terminal was before; none where there is none, and when it has been given back.
    before: Option<Termios>,
}

impl Dashboard {
    /// Opens it; `executable` is ironbird's own.
    ///
    /// # Errors
    /// [`Failure`] with the system's reason.
    pub fn open(executable: &Path, instance: &Instance) -> Result<Self, Failure> {
        let has_terminal = io::stdin().is_terminal() && io::stdout().is_terminal();
        let before = if has_terminal { tcgetattr(io::stdin()).ok() } else { None };
        let child = Command::new(executable)
            .args(["watch", "--instance", instance.name(), "--launcher", &std::process::id().to_string()])
            .spawn()
            .map_err(|e| Failure::failed(format!("cannot start the dashboard: {e}")))?;
        Ok(Self { child, before })
    }

    /// Whether it still has the terminal, which is restored where the dashboard could not do so itself.
    pub fn is_open(&mut self) -> bool {
        let status = match self.child.try_wait() {
            Ok(None) => return true,
            ended => ended.ok().flatten(),
        };
        let was_killed = status.is_none_or(|status| status.code().is_none());
        if let Some(before) = self.before.take().filter(|_| was_killed) {
            restore(&before);
        }
        false
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
            self.is_open();
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

/// Gives the terminal back as it was.
fn restore(before: &Termios) {
    // Whoever does so in the background is stopped for it.
    if tcgetpgrp(io::stdin()).is_ok_and(|foreground| foreground == getpgrp()) {
        // A terminal that has been closed needs nothing.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, before);
    }
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        self.close();
    }
}
