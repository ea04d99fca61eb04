//! The roles that processes play, in the order of the data flow. A name is also a subcommand.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::layout::wire_enum;

wire_enum! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    #[repr(usize)]
    pub enum Role {
        Plant = 0 => "plant",
        Outer = 1 => "outer",
        /// The inner (attitude and rate) loop.
        Inner = 2 => "inner",
        Mixer = 3 => "mixer",
        /// The recorder: no part of the loop, not real-time.
        Record = 4 => "record",
    }
}

/// The four roles of the control loop.
pub const STAGES: [Role; 4] = [Role::Plant, Role::Outer, Role::Inner, Role::Mixer];

pub const ROLES: [Role; 5] = Role::ALL;

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
