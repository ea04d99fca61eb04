//! The signals that ask a process to end in order, the end of its launcher, and the signals that it inherits.
//!
//! | signal          | who sends it                                             | when it comes again      |
//! |-----------------|----------------------------------------------------------|--------------------------|
//! | SIGINT, SIGQUIT | a person at the keyboard                                 | ends the process at once |
//! | SIGTERM, SIGHUP | a program; the kernel, for a closed terminal or launcher | is the same wish again   |
//!
//! The kernel reports the death of a parent once for each thread of the parent, a few milliseconds apart. Both the
//! kernel and the shell may report a closed terminal. So only a repeated signal of a person means impatience.
//!
//! A process inherits its signal mask and its ignored signals through exec. A daemon or a harness that blocks SIGALRM
//! would take the mixer's deadline away, one that blocks SIGTERM would prevent every orderly end, and one that ignores
//! SIGCHLD would hide the launcher's children from it. SIGHUP and SIGQUIT stay ignored if they were: that is what
//! `nohup` and a shell's background jobs ask for.

use std::io;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::{self, sleep};
use std::time::Duration;

use errors::Failure;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Signal, getpid, kill_process, pidfd_open, set_parent_process_death_signal,
};
use signal_hook::consts::{SIGALRM, SIGCHLD, SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::flag;

use crate::rt::{is_ignored, no_longer_ignore};
use ipc::error::Error;
use ipc::sys::mask_signals;

/// The signals that ask for the end.
///
/// SIGHUP and SIGQUIT are not among them if they are ignored: a user who starts a process with `nohup`, or in the
/// background of a script, wants it to survive the terminal and its keys.
pub fn stop_signals() -> Vec<i32> {
    let respected = [SIGHUP, SIGQUIT]
        .into_iter()
        .filter(|signal| !is_ignored(*signal));
    [SIGINT, SIGTERM].into_iter().chain(respected).collect()
}

/// A flag that a stop signal sets; long work polls it.
pub fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in stop_signals() {
        flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    Ok(stop)
}

/// Whether a signal ends the process at once after the end was requested.
pub const fn ends_at_once(signal: i32) -> bool {
    matches!(signal, SIGINT | SIGQUIT)
}

/// Whether a signal asks for the end, wherever it is not ignored.
pub const fn asks_for_the_end(signal: i32) -> bool {
    matches!(signal, SIGINT | SIGQUIT | SIGTERM | SIGHUP)
}

/// Signals that are never ignored: the mixer's deadline, children's ends, and what ends a flight in order.
const NEEDED: [i32; 4] = [SIGALRM, SIGCHLD, SIGINT, SIGTERM];

/// Forgets the signal mask that was inherited, and that needed signals were ignored. First of all in `main`: threads
/// inherit the mask from the one that starts them.
pub fn forget_inherited() -> Result<(), Error> {
    mask_signals(libc::SIG_SETMASK, &[]).map_err(|e| Error::system("cannot unblock signals", e))?;
    NEEDED.into_iter().try_for_each(|signal| {
        no_longer_ignore(signal)
            .map_err(|e| Error::system(format!("cannot take signal {signal}"), e))
    })
}

/// A command of an `ironbird` executable for a child that ends with this process.
pub fn child(executable: &Path, command: &str) -> Command {
    let mut child = Command::new(executable);
    child.args([command, "--launcher", &std::process::id().to_string()]);
    child
}

/// How long a process may take to end after its launcher has died.
const ENDS_WITHIN: Duration = Duration::from_secs(10);

/// Asks the kernel for SIGTERM when the launcher, who must be the parent, dies.
///
/// It comes once for each thread of the launcher; the process must take all of them for one. If it then does not end,
/// because a law does not return, it is killed.
pub fn end_with_launcher(launcher: Option<u32>) -> Result<(), Error> {
    let Some(launcher) = launcher else {
        return Ok(());
    };
    let failed = |e: io::Error| Error::system("cannot tie the process to its launcher", e);
    set_parent_process_death_signal(Some(Signal::TERM)).map_err(|e| failed(e.into()))?;
    // It may have died before the wish was known.
    if !is_parent(launcher) {
        return Err(Error::Interrupted);
    }
    let pid = i32::try_from(launcher).ok().and_then(Pid::from_raw);
    // Before Linux 5.3 there is no such descriptor.
    if let Some(Ok(end)) = pid.map(|pid| pidfd_open(pid, PidfdFlags::empty())) {
        let watch = move || {
            while let Err(Errno::INTR) = poll(&mut [PollFd::new(&end, PollFlags::IN)], None) {}
            if !is_parent(launcher) {
                sleep(ENDS_WITHIN);
                let _ = kill_process(getpid(), Signal::KILL);
            }
        };
        let name = "launcher".to_owned();
        thread::Builder::new()
            .name(name)
            .spawn(watch)
            .map_err(failed)?;
    }
    Ok(())
}

/// Whether this process has no launcher, or its launcher has died: then no process cleans up after it.
pub fn is_on_its_own(launcher: Option<u32>) -> bool {
    launcher.is_none_or(|launcher| !is_parent(launcher))
}

fn is_parent(pid: u32) -> bool {
    rustix::process::getppid()
        .is_some_and(|parent| parent.as_raw_nonzero().get().unsigned_abs() == pid)
}
