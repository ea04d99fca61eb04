//! Limits of the process that would end it without a word: heeded first of all.

use std::sync::Arc;

use rustix::process::{Resource, getrlimit};
use signal_hook::consts::SIGXFSZ;

use failure::Failure;

/// What the main thread's stack must hold [bytes]: a role touches 256 KiB of it before it arms.
const STACK_BYTES: u64 = 1 << 20;

/// Has files that become too long for the user's limit refuse what is written, and refuses a stack that is too small.
///
/// # Errors
/// [`Failure`] names the limit and what is needed.
pub fn heed() -> Result<(), Failure> {
    // By default the signal ends the process; with a handler, writing fails, which whoever writes then says.
    signal_hook::flag::register(SIGXFSZ, Arc::default())
        .map_err(|e| Failure::failed(format!("cannot handle SIGXFSZ: {e}")))?;
    match getrlimit(Resource::Stack).current {
        Some(bytes) if bytes < STACK_BYTES => Err(Failure::failed(format!(
            "the stack may have {} KiB, this program needs {}",
            bytes >> 10,
            STACK_BYTES >> 10
        ))
        .help("raise the limit: ulimit -s 8192")),
        _ => Ok(()),
    }
}
