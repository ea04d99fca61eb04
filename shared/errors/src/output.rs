//! Writes to standard output and standard error. A reader that has gone is no failure.

use std::io::{self, ErrorKind, IsTerminal, Write as _};

use rustix::fs::{FileType, fstat};
use rustix::io::Errno;

use crate::{Failure, harmless};

/// Writes a text to standard output. It is no failure if the reader has closed the pipe, as `head` does, or the terminal.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    let written = out.write_all(harmless(text).as_bytes());
    match written.and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe && !is_of_a_closed_terminal(&e) => Err(
            Failure::failed(format!("cannot write to standard output: {e}")),
        ),
        _ => Ok(()),
    }
}

/// Whether a stream is a terminal that knows escape sequences.
pub fn has_screen(stream: &impl IsTerminal) -> bool {
    stream.is_terminal()
        && std::env::var_os("TERM").is_some_and(|name| !name.is_empty() && name != "dumb")
}

/// Writes a text to standard error, if anybody still reads it.
pub fn say(text: &str) {
    let mut err = io::stderr().lock();
    // There is no other place to report an error.
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// Whether standard output was a terminal that has been closed: on a disk the same error is one.
fn is_of_a_closed_terminal(error: &io::Error) -> bool {
    let is_device =
        || fstat(io::stdout()).is_ok_and(|it| FileType::from_raw_mode(it.st_mode).is_char_device());
    error.raw_os_error() == Some(Errno::IO.raw_os_error()) && is_device()
}
