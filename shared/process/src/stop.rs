//! The signals that ask a process to end in order, and what repeating them means.
//!
//! | signal          | who sends it                                             | when it comes again      |
//! |-----------------|----------------------------------------------------------|--------------------------|
//! | SIGINT, SIGQUIT | a person at the keyboard                                 | ends the process at once |
//! | SIGTERM, SIGHUP | a program; the kernel, for a closed terminal or launcher | is the same wish again   |
//!
//! The kernel reports the death of a parent once for each thread of the parent, a few milliseconds apart. Both the
//! kernel and the shell may report a closed terminal. So only a repeated signal of a person means impatience.

use std::fs;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

/// The signals that ask for the end.
///
/// SIGHUP and SIGQUIT are not among them where they are ignored: whoever starts a process with `nohup`, or in the
/// background of a script, wants it to survive the terminal and its keys.
pub fn stop_signals() -> Vec<i32> {
    let respected = [SIGHUP, SIGQUIT]
        .into_iter()
        .filter(|signal| !is_ignored(*signal));
    [SIGINT, SIGTERM].into_iter().chain(respected).collect()
}

/// Whether a signal ends the process at once when the end has been asked for already.
pub const fn ends_at_once(signal: i32) -> bool {
    matches!(signal, SIGINT | SIGQUIT)
}

/// Whether a signal asks for the end, wherever it is not ignored.
pub const fn asks_for_the_end(signal: i32) -> bool {
    matches!(signal, SIGINT | SIGQUIT | SIGTERM | SIGHUP)
}

/// Whether this process ignores a signal, as its parent may have wanted it to.
fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
