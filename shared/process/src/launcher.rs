//! Processes that end when their launcher does.

use ipc::error::Error;

/// Asks the kernel for SIGTERM when the launcher, who must be the parent, dies.
///
/// It comes once for each thread of the launcher; whoever asks for it must take all of them for one.
pub fn end_with_launcher(launcher: Option<u32>) -> Result<(), Error> {
    let Some(launcher) = launcher else {
        return Ok(());
    };
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))
        .map_err(|e| Error::system("cannot tie the process to its launcher", e))?;
    // It may have died before the wish was known.
    if is_parent(launcher) {
        Ok(())
    } else {
        Err(Error::Interrupted)
    }
}

/// Whether nobody launched this process, or the one who did has died: then nobody tidies up after it.
pub fn is_on_its_own(launcher: Option<u32>) -> bool {
    launcher.is_none_or(|launcher| !is_parent(launcher))
}

fn is_parent(pid: u32) -> bool {
    rustix::process::getppid()
        .is_some_and(|parent| parent.as_raw_nonzero().get().unsigned_abs() == pid)
}
