//! Compares replayed messages with the recorded ones, bit for bit.

use std::fmt;

use model::role::Role;
use model::topic::Topic;

use flight_log::codec::Logged;
use flight_log::rows::{named, words};

/// A value that came out differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// At which tick.
    pub tick: u64,
    /// Whose output.
    pub stage: Role,
    /// On which topic.
    pub topic: &'static str,
    /// Which field.
    pub field: String,
    /// What the log says.
    pub recorded: String,
    /// What came out now.
    pub replayed: String,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tick, stage, topic, field, recorded, replayed } = self;
        write!(f, "tick {tick}, stage {stage}: {topic}.{field} was {recorded}, replayed {replayed}")
    }
}

/// Compares from a tick on, and remembers the first difference.
#[derive(Clone, Debug, Default)]
pub struct ReplayComparison {
    from_tick: u64,
    /// Values compared.
    pub values: u64,
    /// The first difference.
    pub first: Option<Divergence>,
}

impl ReplayComparison {
    /// Compares nothing before a tick.
    #[must_use]
    pub fn from(from_tick: u64) -> Self {
        Self { from_tick, ..Self::default() }
    }

    /// Compares a content of a tick.
    pub fn compare<C: Logged>(&mut self, tick: u64, recorded: &C, replayed: &C) {
        if tick < self.from_tick {
            return;
        }
        if recorded.is_same(replayed) {
            self.values += (size_of::<C>() / size_of::<u64>()) as u64;
        } else {
            let differs = words(recorded).iter().zip(&words(replayed)).position(|(a, b)| a != b).unwrap_or(0);
            let name = |content: &C| named(content).into_iter().nth(differs).unwrap_or_default();
            let ((field, recorded), (_, replayed)) = (name(recorded), name(replayed));
            self.differ::<C>(tick, field, recorded, replayed);
        }
    }

    /// Takes a difference down, if it is the first.
    pub fn differ<C: Logged>(&mut self, tick: u64, field: String, recorded: String, replayed: String) {
        if tick >= self.from_tick {
            let (stage, topic) = (C::SENDER, <C as Topic>::NAME);
            self.first.get_or_insert(Divergence { tick, stage, topic, field, recorded, replayed });
        }
    }
}
