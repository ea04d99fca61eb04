//! Entry check of every message: copied once, then accepted or counted by reason.

use crate::checks::{Check, is_on};
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
    epoch: u64,
    seq: u64,
    tick: u64,
}

impl Inspector {
    pub const fn new(expected: Expected) -> Self {
        Self {
            expected,
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
            (envelope.layout != LAYOUT, Check::Layout, Reason::Layout),
            (envelope.run_id != run_id, Check::Run, Reason::Run),
            (
                envelope.settings != settings,
                Check::Settings,
                Reason::Settings,
            ),
            (is_replaced, Check::Sequence, Reason::Sequence),
            (is_of_other_tick, Check::Tick, Reason::Tick),
        ];
        let failed = failed
            .iter()
            .find(|(fails, check, _)| *fails && is_on(*check));
        if let Some((_, _, reason)) = failed {
            return Err(*reason);
        }
        if !content.finite() && is_on(Check::NonFinite) {
            return Err(Reason::NonFinite);
        }
        if !content.plausible() && is_on(Check::Implausible) {
            return Err(Reason::Implausible);
        }
        self.epoch = envelope.epoch;
        self.seq = envelope.seq;
        self.tick = envelope.tick;
        Ok(())
    }
}
