//! Processes that end when their launcher does.

use wire::error::Error;

/// Asks the kernel for SIGTERM when the launcher, who must be the parent, dies.
///
/// # Errors
/// [`Error::Interrupted`] where it is dead already; [`Error::System`].
pub fn end_with_launcher(launcher: Option<u32>) -> Result<(), Error> {
    let Some(launcher) = launcher else { return Ok(()) };
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))
        .map_err(|e| Error::system("cannot tie the process to its launcher", e))?;
    // It may have died before the wish was known.
    let parent = rustix::process::getppid().map(|pid| pid.as_raw_nonzero().get().unsigned_abs());
    if parent == Some(launcher) { Ok(()) } else { Err(Error::Interrupted) }
}
