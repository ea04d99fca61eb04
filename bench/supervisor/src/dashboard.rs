//! The dashboard of `fly --watch`, a child process in the supervisor's terminal, and the servers of `fly --web` and
//! `fly --mavlink`, ones without a terminal.
//!
//! The supervisor continues when the user leaves the dashboard. It restores the terminal before it prints, even if the
//! dashboard was killed.

use std::io::{self, BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

use ipc::instance::Instance;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::LeaveAlternateScreen;
use rustix::process::getpgrp;
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

use crate::ServerProcess;
use crate::child_process::{end, wait_at_most};
use errors::Failure;
use errors::output::has_screen;

/// How long the dashboard may take to notice the end of the flight and to restore the terminal.
const EXIT_TIMEOUT: Duration = Duration::from_secs(1);

#[derive(Debug)]
pub struct Dashboard {
    child: Child,
    /// The terminal's original mode; none without a terminal, and after it has been restored.
    before: Option<Termios>,
}

impl Dashboard {
    pub fn open(executable: &Path, instance: &Instance) -> Result<Self, Failure> {
        let has_terminal = has_screen(&io::stdin()) && has_screen(&io::stdout());
        let before = tcgetattr(io::stdin()).ok().filter(|_| has_terminal);
        let child = process::signals::child(executable, "watch")
            .args(["--instance", instance.name()])
            .spawn()
            .map_err(|e| Failure::failed(format!("cannot start the dashboard: {e}")))?;
        Ok(Self { child, before })
    }

    /// Starts a server; returns also the line in which the process prints its address.
    pub fn serve(
        executable: &Path,
        instance: &Instance,
        server: &ServerProcess,
    ) -> Result<(Self, String), Failure> {
        let what = server.what;
        let failed = |e| Failure::failed(format!("cannot start {what}: {e}"));
        let mut child = process::signals::child(executable, server.command)
            .args(&server.arguments)
            .args(["--instance", instance.name()])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let mut line = String::new();
        let stdout = child.stdout.take().map(BufReader::new);
        let read = stdout.map_or(Ok(0), |mut out| out.read_line(&mut line));
        let process = Self {
            child,
            before: None,
        };
        match read.map_err(failed)? {
            0 => Err(Failure::failed(format!(
                "{what} could not be served, for the reason above"
            ))),
            _ => Ok((process, line.trim_end().to_owned())),
        }
    }

    /// Whether its process was killed or failed.
    pub fn has_failed(&mut self) -> bool {
        let status = self.child.try_wait();
        status.is_ok_and(|status| status.is_some_and(|status| !status.success()))
    }

    /// Whether the dashboard has the terminal. Restores the terminal if the dashboard was killed.
    pub fn has_terminal(&mut self) -> bool {
        let status = match self.child.try_wait() {
            Ok(None) => return self.before.is_some(),
            ended => ended.ok().flatten(),
        };
        let was_killed = status.is_none_or(|status| status.code().is_none());
        if let Some(before) = self.before.take().filter(|_| was_killed) {
            restore(&before);
        }
        false
    }

    /// Waits until the dashboard ends with the flight; otherwise ends it.
    pub fn close(&mut self) {
        if wait_at_most(&mut self.child, EXIT_TIMEOUT).is_none() {
            end(&mut self.child, EXIT_TIMEOUT);
        }
        self.has_terminal();
    }
}

fn restore(before: &Termios) {
    // A background process that did this would be stopped.
    if tcgetpgrp(io::stdin()).is_ok_and(|foreground| foreground == getpgrp()) {
        // A closed terminal needs no restoring.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, before);
    }
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
}

impl Drop for Dashboard {
    fn drop(&mut self) {
        self.close();
    }
}
