//! Resets the signals that a process inherits from whoever has started it.
//!
//! A process inherits its signal mask and its ignored signals through exec. A daemon or a harness that blocks SIGALRM
//! would take the mixer's deadline away, one that blocks SIGTERM would prevent every orderly end, and one that ignores
//! SIGCHLD would hide the launcher's children from it. SIGHUP and SIGQUIT stay ignored if they were: that is what
//! `nohup` and a shell's background jobs ask for.

use signal_hook::consts::{SIGALRM, SIGCHLD, SIGINT, SIGTERM};

use crate::rt::no_longer_ignore;
use ipc::error::Error;
use ipc::sys::mask_signals;

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
