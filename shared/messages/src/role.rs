//! The roles that processes play, in the order of the data flow.

use std::fmt;

use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(usize)]
pub enum Role {
    Plant,
    Outer,
    /// The inner (attitude and rate) loop.
    Inner,
    Mixer,
    /// The recorder: no part of the loop, not real-time.
    Record,
}

/// The four roles of the control loop.
pub const STAGES: [Role; 4] = [Role::Plant, Role::Outer, Role::Inner, Role::Mixer];

pub const ROLES: [Role; 5] = [
    Role::Plant,
    Role::Outer,
    Role::Inner,
    Role::Mixer,
    Role::Record,
];

impl Role {
    /// Share of the tick, in percent, after which a stage no longer waits for its input.
    ///
    /// Staggered along the chain, so that each stage can still hand on what it makes of stale data.
    pub const fn deadline_percent(self) -> u64 {
        match self {
            Self::Outer => 70,
            Self::Inner => 80,
            _ => 90,
        }
    }

    /// Its name, which is also its subcommand.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Outer => "outer",
            Self::Inner => "inner",
            Self::Mixer => "mixer",
            Self::Record => "record",
        }
    }

    /// Steps above the lowest real-time priority of the rig: later stages preempt earlier ones, so that a
    /// stage that has its input is never held up by one that has already delivered.
    pub const fn priority_step(self) -> i32 {
        self as i32
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
