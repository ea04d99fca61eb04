//! Why messages are refused, and how many were.

use crate::layout::{enum_hash, layout};

/// Why a message was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Reason {
    /// Damaged on its way: its check word is not that of what came.
    Checksum,
    Layout,
    Run,
    /// Its sender flies with other settings.
    Settings,
    /// Of a sender that has been replaced, or not newer than the last one of its sender.
    Sequence,
    /// Made for a tick that has not begun, or for one that the topic has passed.
    Tick,
    /// A number that is not finite.
    NonFinite,
    /// A number that no airframe can have, or a flag that does not exist.
    Implausible,
}

/// Every reason, in the order of [`Rejections`].
pub const REASONS: [Reason; 8] = [
    Reason::Checksum,
    Reason::Layout,
    Reason::Run,
    Reason::Settings,
    Reason::Sequence,
    Reason::Tick,
    Reason::NonFinite,
    Reason::Implausible,
];

enum_hash!(Reason {
    Checksum,
    Layout,
    Run,
    Settings,
    Sequence,
    Tick,
    NonFinite,
    Implausible
});

impl Reason {
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Checksum => "checksum",
            Self::Layout => "layout",
            Self::Run => "run",
            Self::Settings => "settings",
            Self::Sequence => "sequence",
            Self::Tick => "tick",
            Self::NonFinite => "non_finite",
            Self::Implausible => "implausible",
        }
    }
}

/// Messages rejected so far, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Rejections {
    counts: [u64; REASONS.len()],
}
layout!(Rejections { counts });

impl Rejections {
    pub fn count(&mut self, reason: Reason) {
        self.counts[reason as usize] += 1;
    }

    #[must_use]
    pub const fn of(&self, reason: Reason) -> u64 {
        self.counts[reason as usize]
    }

    #[must_use]
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Adds those of another port of the same process.
    #[must_use]
    pub fn and(mut self, other: &Self) -> Self {
        for (count, more) in self.counts.iter_mut().zip(other.counts) {
            *count += more;
        }
        self
    }
}
