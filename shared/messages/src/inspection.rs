//! Entry check of every message: copied once, then accepted or counted by reason.

use crate::content::NO_TICK;
use crate::header::{LAYOUT, Message};
pub use crate::rejections::{Reason, Rejections};
use crate::topic::Topic;

/// What the receiver expects of a run's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    pub run_id: u64,
    pub settings: u64,
}

/// Entry check of one topic: remembers what it has let through.
#[derive(Clone, Copy, Debug)]
pub struct Inspector {
    expected: Expected,
    /// Whether the messages are of changing senders, so that epochs and sequence numbers say nothing.
    is_relayed: bool,
    epoch: u64,
    seq: u64,
    tick: u64,
}

impl Inspector {
    pub const fn new(expected: Expected, is_relayed: bool) -> Self {
        Self {
            expected,
            is_relayed,
            epoch: 0,
            seq: 0,
            tick: NO_TICK,
        }
    }

    /// Lets a message through, or says why not. `newest_tick` is the latest tick that can have begun.
    pub fn inspect<C: Topic>(
        &mut self,
        message: &Message<C>,
        newest_tick: u64,
    ) -> Result<(), Reason> {
        let Message { envelope, content } = message;
        let first = self.tick == NO_TICK;
        let is_replaced = envelope.epoch < self.epoch
            || (!first && envelope.epoch == self.epoch && envelope.seq <= self.seq);
        let is_of_other_tick = envelope.tick > newest_tick
            || (!first && envelope.tick < self.tick + u64::from(!C::MANY_PER_TICK));
        let Expected { run_id, settings } = self.expected;
        let failed = [
            (envelope.layout != LAYOUT, Reason::Layout),
            (envelope.run_id != run_id, Reason::Run),
            (envelope.settings != settings, Reason::Settings),
            (is_replaced && !self.is_relayed, Reason::Sequence),
            (is_of_other_tick, Reason::Tick),
        ];
        if let Some((_, reason)) = failed.iter().find(|(fails, _)| *fails) {
            return Err(*reason);
        }
        if !content.finite() {
            return Err(Reason::NonFinite);
        }
        if !content.plausible() {
            return Err(Reason::Implausible);
        }
        self.epoch = envelope.epoch;
        self.seq = envelope.seq;
        self.tick = envelope.tick;
        Ok(())
    }
}
