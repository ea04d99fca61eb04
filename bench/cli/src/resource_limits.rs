//! Checks the resource limits that would otherwise end this process without a message.

use std::sync::Arc;

use rustix::process::{Resource, getrlimit};
use signal_hook::consts::SIGXFSZ;

use errors::Failure;

/// Required size of the main thread's stack [bytes]: a role touches 256 KiB of it before it is ready.
const STACK_BYTES: u64 = 1 << 20;
/// Address space that a role needs, including shared memory and a reserve [bytes]. With less, a failed allocation aborts it.
const SPACE_BYTES: u64 = 80 << 20;

/// Refuses limits that are too low. Makes a write fail, instead of ending the process, if a file exceeds its limit.
pub fn check() -> Result<(), Failure> {
    // By default the signal ends the process. With a handler the write fails, and the writer reports that.
    signal_hook::flag::register(SIGXFSZ, Arc::default())
        .map_err(|e| Failure::failed(format!("cannot handle SIGXFSZ: {e}")))?;
    enough(Resource::Stack, STACK_BYTES, "the stack", "ulimit -s 8192")?;
    enough(
        Resource::As,
        SPACE_BYTES,
        "the address space",
        "ulimit -v unlimited",
    )
}

fn enough(resource: Resource, needed: u64, what: &str, remedy: &str) -> Result<(), Failure> {
    match getrlimit(resource).current.filter(|bytes| *bytes < needed) {
        Some(bytes) => {
            let (bytes, needed) = (bytes >> 10, needed >> 10);
            Err(Failure::failed(format!(
                "{what} is limited to {bytes} KiB; this program needs {needed} KiB"
            ))
            .help(format!("raise the limit: {remedy}")))
        }
        None => Ok(()),
    }
}
