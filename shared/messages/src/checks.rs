//! Guards that a build of the drill can switch off, one at a time: a test that stays green then would be none.
//!
//! Only a build with `IRONBIRD_BUILD_MUTANTS` set has them (`bench/drill/mutants`). In every other build [`is_on`] is
//! constant, and nothing of this is left in the executable.

use std::sync::atomic::{AtomicU8, Ordering};

/// Whether this build can switch guards off; an empty variable asks for nothing.
pub const IS_MUTANT: bool = match option_env!("IRONBIRD_BUILD_MUTANTS") {
    Some(asked) => !asked.is_empty(),
    None => false,
};

macro_rules! guards {
    ($($(#[$doc:meta])* $guard:ident = $name:literal),+ $(,)?) => {
        /// What stands between a fault and the flight.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Check {
            $($(#[$doc])* $guard),+
        }

        pub const GUARDS: &[(&str, Check)] = &[$(($name, Check::$guard)),+];
    };
}

guards! {
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
    Header = "envelope",
    /// A role is started again so often and no more.
    RestartLimit = "restart_limit",
    /// A loop whose ticks stand still is killed.
    Heartbeat = "heartbeat",
    /// A role believes a run only while the plant that wrote it lives.
    RunCheck = "run_check",
}

/// The guard that is off, plus one; 0 is none.
static OFF: AtomicU8 = AtomicU8::new(0);

/// Whether a guard does its work: always, in a build that is no mutant.
#[inline(always)]
pub fn is_on(guard: Check) -> bool {
    !IS_MUTANT || OFF.load(Ordering::Relaxed) != guard as u8 + 1
}

/// Switches one guard of this process off by its name, in a mutant; tells whether it did.
pub fn switch_off(name: &str) -> bool {
    let found = GUARDS.iter().find(|(known, _)| IS_MUTANT && *known == name);
    found
        .inspect(|(_, guard)| OFF.store(*guard as u8 + 1, Ordering::Relaxed))
        .is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usual_build_switches_no_guard_off() {
        for (name, guard) in GUARDS {
            assert_eq!(switch_off(name), IS_MUTANT, "{name}");
            assert_eq!(is_on(*guard), !IS_MUTANT, "{name}");
        }
        assert!(!switch_off("no guard"));
    }
}
