//! How the plant waits for its ticks.

use ipc::clock::{now_ns, sleep_until};

/// How the plant woke for a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waking {
    /// When it began the tick [ns].
    pub wake_ns: u64,
    /// How far ahead of the tick its timer was to be set [ns].
    pub lead_ns: u64,
    /// How late the kernel woke it, after the instant that its timer was set to [ns].
    pub timer_late_ns: u64,
}

/// Sleeps until an instant, through signals; gives when it woke.
pub fn wait_until(instant_ns: u64) -> u64 {
    loop {
        sleep_until(instant_ns);
        let now = now_ns();
        if now >= instant_ns {
            return now;
        }
    }
}
