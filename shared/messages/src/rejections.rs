//! Why messages are refused, and how many were.

use crate::layout::{layout, wire_enum};

wire_enum! {
    pub enum Reason {
        /// Damaged on its way: its check word is not that of what came.
        Checksum = 0 => "checksum",
        Layout = 1 => "layout",
        Run = 2 => "run",
        Settings = 3 => "settings",
        /// Of a sender that has been replaced, or not newer than the last one of its sender.
        Sequence = 4 => "sequence",
        /// Made for a tick that has not begun, or for one that the topic has passed.
        Tick = 5 => "tick",
        NonFinite = 6 => "non_finite",
        /// A number that no airframe can have, or a flag that does not exist.
        Implausible = 7 => "implausible",
    }
}

layout! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Rejections {
        counts: [u64; Reason::ALL.len()],
    }
}

impl Rejections {
    pub fn count(&mut self, reason: Reason) {
        self.counts[reason as usize] += 1;
    }

    pub const fn of(&self, reason: Reason) -> u64 {
        self.counts[reason as usize]
    }

    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Adds those of another port of the same process.
    pub fn and(mut self, other: &Self) -> Self {
        for (count, more) in self.counts.iter_mut().zip(other.counts) {
            *count += more;
        }
        self
    }
}
