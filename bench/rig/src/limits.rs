//! Checks the resource limits that would end this process without a message.

use std::sync::Arc;

use rustix::process::{Resource, getrlimit};
use signal_hook::consts::SIGXFSZ;

use failure::Failure;

/// What the main thread's stack must hold [bytes]: a role touches 256 KiB of it before it arms.
const STACK_BYTES: u64 = 1 << 20;
/// What a role maps, shared memory with it, and a little more [bytes]: with less, an allocation that fails aborts it.
const SPACE_BYTES: u64 = 80 << 20;

/// Has files that become too long for the user's limit refuse what is written, and refuses limits that are too low.
///
/// # Errors
/// [`Failure`] names the limit and what is needed.
pub fn heed() -> Result<(), Failure> {
    // By default the signal ends the process; with a handler, writing fails, which whoever writes then says.
    signal_hook::flag::register(SIGXFSZ, Arc::default())
        .map_err(|e| Failure::failed(format!("cannot handle SIGXFSZ: {e}")))?;
    enough(Resource::Stack, STACK_BYTES, "the stack", "ulimit -s 8192")?;
    enough(Resource::As, SPACE_BYTES, "the address space", "ulimit -v unlimited")
}

fn enough(resource: Resource, needed: u64, what: &str, remedy: &str) -> Result<(), Failure> {
    match getrlimit(resource).current.filter(|bytes| *bytes < needed) {
        Some(bytes) => {
            let (bytes, needed) = (bytes >> 10, needed >> 10);
            Err(Failure::failed(format!("{what} may have {bytes} KiB, this program needs {needed}"))
                .help(format!("raise the limit: {remedy}")))
        }
        None => Ok(()),
    }
}
