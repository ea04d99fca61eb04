//! Standard output of a command: written whole, and a reader that has gone is no failure.

use std::io::{self, ErrorKind, Write as _};

use failure::Failure;

/// Writes a text to standard output.
///
/// # Errors
/// [`Failure`] with the system's reason; not when the reader has closed the pipe, as `head` does.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::failed(format!("cannot write to standard output: {e}")))
        }
        _ => Ok(()),
    }
}
