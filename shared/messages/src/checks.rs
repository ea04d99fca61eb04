//! Checks that a build of the drill can switch off, one at a time: a test that still passes without its check
//! is useless.
//!
//! Only a build with `IRONBIRD_BUILD_MUTANTS` set has them (`bench/drill/mutants`). In every other build [`is_on`] is
//! constant, and nothing of this is left in the executable.

use std::sync::atomic::{AtomicU8, Ordering};

/// Whether this build can switch checks off; an empty variable asks for nothing.
pub const IS_MUTANT: bool = match option_env!("IRONBIRD_BUILD_MUTANTS") {
    Some(asked) => !asked.is_empty(),
    None => false,
};

macro_rules! checks {
    ($($(#[$doc:meta])* $check:ident = $name:literal),+ $(,)?) => {
        /// A check that the drill can switch off.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Check {
            $($(#[$doc])* $check),+
        }

        pub const CHECKS: &[(&str, Check)] = &[$(($name, Check::$check)),+];
    };
}

checks! {
    Checksum = "inspection.checksum",
    Layout = "inspection.layout",
    Run = "inspection.run",
    Settings = "inspection.settings",
    Sequence = "inspection.sequence",
    Tick = "inspection.tick",
    NonFinite = "inspection.non_finite",
    Implausible = "inspection.implausible",
    /// An input that is missing for long is no longer held.
    Stale = "stale_windows",
    /// The plant ends a flight that has crashed, or has left its envelope.
    Envelope = "envelope",
    /// The number of restarts is limited.
    RestartLimit = "restart_limit",
    /// A loop that hangs is killed.
    Heartbeat = "heartbeat",
    /// A role accepts a run only while the plant that wrote it lives.
    RunCheck = "run_check",
}

/// The check that is off, plus one; 0 is none.
static OFF: AtomicU8 = AtomicU8::new(0);

/// Whether a check is on: in a normal build, always.
#[inline(always)]
pub fn is_on(check: Check) -> bool {
    !IS_MUTANT || OFF.load(Ordering::Relaxed) != check as u8 + 1
}

/// Switches one check of this process off by its name, in a mutant; tells whether it did.
pub fn switch_off(name: &str) -> bool {
    let found = CHECKS.iter().find(|(known, _)| IS_MUTANT && *known == name);
    found
        .inspect(|(_, check)| OFF.store(*check as u8 + 1, Ordering::Relaxed))
        .is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usual_build_switches_no_check_off() {
        for (name, check) in CHECKS {
            assert_eq!(switch_off(name), IS_MUTANT, "{name}");
            assert_eq!(is_on(*check), !IS_MUTANT, "{name}");
        }
        assert!(!switch_off("no check"));
    }
}
