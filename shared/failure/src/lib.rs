//! How a command fails: exit code, what happened, what to do about it.

use std::fmt;
use std::fs::OpenOptions;
use std::path::Path;

/// Exit code of a run or command that did what it should.
pub const OK: u8 = 0;
/// Something failed while running.
pub const FAILED: u8 = 1;
/// A flag, a key, a file or a name is wrong; nothing was started.
pub const USAGE: u8 = 2;
/// The flight ended, and a gate did not hold; the machine cannot fly in real time.
pub const GATE: u8 = 3;
/// Another instance runs, or shared memory is in the way.
pub const OCCUPIED: u8 = 5;
/// A signal ended it.
pub const INTERRUPTED: u8 = 130;

/// Why a command did not do what it was asked.
#[derive(Debug)]
pub struct Failure {
    /// Exit code (docs/architecture.md, "Exit codes").
    pub code: u8,
    message: String,
    help: Option<String>,
}

impl Failure {
    /// What the user can do, if that is known.
    #[must_use]
    pub fn remedy(&self) -> Option<&str> {
        self.help.as_deref()
    }
}

impl Failure {
    /// A failure with an exit code.
    #[must_use]
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), help: None }
    }

    /// A mistake in what the user typed.
    #[must_use]
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(USAGE, message)
    }

    /// A failure while running.
    #[must_use]
    pub fn failed(message: impl Into<String>) -> Self {
        Self::new(FAILED, message)
    }

    /// Adds to what happened.
    #[must_use]
    pub fn append(mut self, more: &str) -> Self {
        self.message.push_str(more);
        self
    }

    /// Adds what the user can do.
    #[must_use]
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

/// Names the file in an I/O failure.
pub trait InFile<T> {
    /// The failure "cannot `doing` `path`".
    ///
    /// # Errors
    /// The failure, with the system's reason.
    fn in_file(self, doing: &str, path: &Path) -> Result<T, Failure>;
}

impl<T, E: fmt::Display> InFile<T> for Result<T, E> {
    fn in_file(self, doing: &str, path: &Path) -> Result<T, Failure> {
        self.map_err(|e| Failure::failed(format!("cannot {doing} {}: {e}", path.display())))
    }
}

/// Whether a file that a flag names can be written: asked before anything starts.
///
/// # Errors
/// A usage [`Failure`] names flag and file.
pub fn check_writable(flag: &str, path: Option<&Path>) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    let refused = |e| Failure::usage(format!("{flag}: cannot write {}: {e}", path.display()));
    OpenOptions::new().create(true).append(true).open(path).map(|_| ()).map_err(refused)
}
