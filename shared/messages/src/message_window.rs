//! The newest messages of a topic, to find the inputs of later messages.

use std::collections::VecDeque;

use crate::content::{NO_TICK, Stamped};
use crate::header::{Header, Message};
use crate::topic::Topic;

/// Messages of a topic in ascending order of ticks.
#[derive(Clone, Debug)]
pub struct MessageWindow<C: Topic> {
    kept: usize,
    never: Stamped<C>,
    messages: VecDeque<(Header, Stamped<C>)>,
}

impl<C: Topic> MessageWindow<C> {
    /// An empty window that keeps `kept` messages before the newest one.
    pub fn keeping(kept: usize) -> Self {
        Self {
            kept,
            never: Stamped::never(),
            messages: VecDeque::new(),
        }
    }

    #[inline]
    pub fn push(&mut self, message: &Message<C>) {
        if self.messages.len() > self.kept {
            // `pop_front` would copy it.
            self.messages.drain(..1);
        }
        let Message { envelope, content } = *message;
        self.messages
            .push_back((envelope, Stamped::new(envelope.tick, content)));
    }

    /// The input of a stage, by the tick that the stage reports; none if that message is not in the window.
    #[inline]
    pub fn input(&self, input_tick: u64) -> Option<&Stamped<C>> {
        if input_tick == NO_TICK {
            return Some(&self.never);
        }
        Some(&self.of(input_tick)?.1)
    }

    /// As [`Self::input`], but keeps the input in `used`, so that it is still found after the window has dropped it.
    #[inline]
    pub fn input_kept<'a>(
        &self,
        input_tick: u64,
        used: &'a mut Stamped<C>,
    ) -> Option<&'a Stamped<C>> {
        if used.tick != input_tick {
            *used = *self.input(input_tick)?;
        }
        Some(used)
    }

    #[inline]
    pub fn of(&self, tick: u64) -> Option<&(Header, Stamped<C>)> {
        let tick_of = |(_, message): &(Header, Stamped<C>)| message.tick;
        // Without gaps, the distance from the newest tick is that of the places. The oldest message is in no cache.
        let ahead = self.messages.back().map_or(0, tick_of).wrapping_sub(tick);
        let likely = (self.messages.len() as u64).wrapping_sub(ahead.wrapping_add(1));
        let likely = self
            .messages
            .get(usize::try_from(likely).unwrap_or(usize::MAX));
        likely.filter(|it| tick_of(it) == tick).or_else(|| {
            let place = self.messages.binary_search_by_key(&tick, tick_of).ok()?;
            self.messages.get(place)
        })
    }
}
