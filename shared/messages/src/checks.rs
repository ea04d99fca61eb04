//! Checks that a build of the drill can switch off, one at a time: a test that still passes without its check
//! is useless.
//!
//! Only a build with `IRONBIRD_BUILD_MUTANTS` set has them (`bench/drill/mutants`). In every other build [`is_on`] is
//! constant, and nothing of this is left in the executable.

use std::sync::atomic::{AtomicU8, Ordering};

use crate::layout::wire_enum;

/// Whether this build can switch checks off; an empty variable asks for nothing.
pub const IS_MUTANT: bool = match option_env!("IRONBIRD_BUILD_MUTANTS") {
    Some(asked) => !asked.is_empty(),
    None => false,
};

wire_enum! {
    /// A check that the drill can switch off. Its number never leaves the process.
    pub enum Check {
        Checksum = 1 => "inspection.checksum",
        Layout = 2 => "inspection.layout",
        Run = 3 => "inspection.run",
        Settings = 4 => "inspection.settings",
        Sequence = 5 => "inspection.sequence",
        Tick = 6 => "inspection.tick",
        NonFinite = 7 => "inspection.non_finite",
        Implausible = 8 => "inspection.implausible",
        /// An input that is missing for long is no longer held.
        Stale = 9 => "stale_windows",
        /// The plant ends a flight that has crashed, or has left its envelope.
        Envelope = 10 => "envelope",
        /// The number of restarts is limited.
        RestartLimit = 11 => "restart_limit",
        /// A loop that hangs is killed.
        Heartbeat = 12 => "heartbeat",
        /// A role accepts a run only while the plant that wrote it lives.
        RunCheck = 13 => "run_check",
    }
}

/// The number of the check that is off; 0 is none.
static OFF: AtomicU8 = AtomicU8::new(0);

/// Whether a check is on: in a normal build, always.
#[inline(always)]
pub fn is_on(check: Check) -> bool {
    !IS_MUTANT || OFF.load(Ordering::Relaxed) != check as u8
}

/// Switches one check of this process off by its name, in a mutant; tells whether it did.
pub fn switch_off(name: &str) -> bool {
    let found = Check::ALL
        .into_iter()
        .find(|check| IS_MUTANT && check.name() == name);
    found
        .inspect(|check| OFF.store(*check as u8, Ordering::Relaxed))
        .is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usual_build_switches_no_check_off() {
        for check in Check::ALL {
            assert_eq!(switch_off(check.name()), IS_MUTANT, "{check:?}");
            assert_eq!(is_on(check), !IS_MUTANT, "{check:?}");
        }
        assert!(!switch_off("no check"));
    }
}
