//! Messages that the recorder did not receive, by the losses that it recorded.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use flight_log::TOPICS;
use flight_log::entry::Counts;
use messages::content::{Loss, NO_TICK};

/// Losses that are kept: the newest.
const KEPT: usize = 1024;

#[derive(Clone, Debug, Default)]
pub struct Losses {
    counts: Counts,
    newest: VecDeque<Loss>,
}

impl Losses {
    pub fn take(&mut self, loss: &Loss) {
        let Some(count) = self.counts.get_mut(loss.topic as usize) else {
            return;
        };
        *count += loss.messages;
        if self.newest.len() == KEPT {
            self.newest.pop_front();
        }
        self.newest.push_back(*loss);
    }

    /// Messages of each topic, in the order of [`TOPICS`].
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Whether a message of one of these topics was lost between messages of these two ticks, or in the tick if it is one.
    pub fn lacks(&self, topics: RangeInclusive<usize>, ticks: RangeInclusive<u64>) -> bool {
        self.newest.iter().any(|loss| {
            let begins_before = loss.after_tick == NO_TICK || loss.after_tick < *ticks.end();
            topics.contains(&(loss.topic as usize))
                && begins_before
                && loss.before_tick > *ticks.start()
        })
    }

    /// Whether a message of the loop may be missing in a tick.
    pub fn lacks_any(&self, tick: u64) -> bool {
        self.lacks(0..=TOPICS.len(), tick..=tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_may_be_missing_in_the_ticks_of_a_loss_and_in_no_other() {
        let mut losses = Losses::default();
        for (topic, after_tick, before_tick) in [(2, NO_TICK, 3), (1, 10, 15)] {
            losses.take(&Loss {
                topic,
                channel: 0,
                messages: 2,
                after_tick,
                before_tick,
            });
        }
        assert_eq!(losses.counts()[..4], [0, 2, 2, 0]);
        let ticks = (0..20).filter(|tick| losses.lacks_any(*tick));
        assert!(ticks.eq([0, 1, 2, 11, 12, 13, 14]));
        let lacks = |after, before| losses.lacks(1..=1, after..=before);
        assert_eq!(
            [lacks(9, 10), lacks(10, 11), lacks(14, 15), lacks(15, 16)],
            [false, true, true, false]
        );
    }
}
