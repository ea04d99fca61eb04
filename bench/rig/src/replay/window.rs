//! The messages of a topic around the tick that is replayed.

use std::collections::VecDeque;

use model::envelope::Message;
use model::messages::{Dated, NO_TICK};
use model::topic::Topic;

use crate::replay::LOOKAHEAD;
use crate::replay::survey::gap;
use failure::Failure;

/// Messages kept behind the one that is replayed. An input is the newest that its stage had; that is never so old.
const KEPT_BEHIND: usize = LOOKAHEAD;

/// Messages of a topic by rising tick, and how far they are replayed.
#[derive(Clone, Debug)]
pub struct Window<C: Topic> {
    messages: VecDeque<Message<C>>,
    /// How many of them are replayed.
    replayed: usize,
}

impl<C: Topic> Window<C> {
    /// An empty window.
    #[must_use]
    pub const fn new() -> Self {
        Self { messages: VecDeque::new(), replayed: 0 }
    }

    /// Takes the next messages.
    pub fn extend(&mut self, messages: &[Message<C>]) {
        let forgotten = self.replayed.saturating_sub(KEPT_BEHIND);
        self.messages.drain(..forgotten);
        self.replayed -= forgotten;
        self.messages.extend(messages);
    }

    /// The message that is to be replayed next.
    #[must_use]
    pub fn next(&self) -> Option<&Message<C>> {
        self.messages.get(self.replayed)
    }

    /// That message is replayed.
    pub const fn advance(&mut self) {
        self.replayed += 1;
    }

    /// What a stage had as its newest input at `tick`, by the tick that it says this was of.
    ///
    /// # Errors
    /// [`Failure`] where the log has no such message.
    pub fn input(&self, input_tick: u64, tick: u64) -> Result<Dated<C>, Failure> {
        if input_tick == NO_TICK {
            return Ok(Dated { tick: NO_TICK, content: C::default() });
        }
        let content = self.messages[self.place(input_tick, tick)?].content;
        Ok(Dated { tick: input_tick, content })
    }

    /// The `count` messages up to the one of tick `last`, which a stage had taken by `tick`.
    ///
    /// # Errors
    /// [`Failure`] where the log has not so many.
    pub fn up_to(&self, last: u64, count: u64, tick: u64) -> Result<impl Iterator<Item = &Message<C>>, Failure> {
        let end = if count > 0 { self.place(last, tick)? + 1 } else { 0 };
        match usize::try_from(count).ok().and_then(|count| end.checked_sub(count)) {
            Some(begin) => Ok(self.messages.range(begin..end)),
            None => Err(gap(&format!("at tick {tick} {count} more `{}` had been taken than before", C::NAME))),
        }
    }

    /// The message of a tick.
    ///
    /// # Errors
    /// [`Failure`] where the log has none.
    pub fn of(&self, tick: u64) -> Result<&Message<C>, Failure> {
        Ok(&self.messages[self.place(tick, tick)?])
    }

    fn place(&self, of_tick: u64, tick: u64) -> Result<usize, Failure> {
        // Where no tick was left out, the distance from the first one says it.
        let first = self.messages.front().map_or(0, |message| message.envelope.tick);
        let likely = usize::try_from(of_tick.wrapping_sub(first)).unwrap_or(usize::MAX);
        if self.messages.get(likely).is_some_and(|message| message.envelope.tick == of_tick) {
            return Ok(likely);
        }
        self.messages.binary_search_by_key(&of_tick, |message| message.envelope.tick).map_err(|_| {
            gap(&format!("at tick {tick} the `{}` of tick {of_tick} was used, which is not in it", C::NAME))
        })
    }
}

impl<C: Topic> Default for Window<C> {
    fn default() -> Self {
        Self::new()
    }
}
