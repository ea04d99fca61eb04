//! The newest messages of a topic, to find those that others were made from.

use std::collections::VecDeque;

use model::envelope::Message;
use model::messages::{Dated, NO_TICK};
use model::topic::Topic;

/// Messages of a topic by rising tick, and how far they are worked through.
#[derive(Clone, Debug)]
pub struct Window<C: Topic> {
    kept: usize,
    messages: VecDeque<Message<C>>,
    /// How many of them are worked through.
    done: usize,
}

impl<C: Topic> Window<C> {
    /// An empty window that keeps so many messages behind the next one.
    #[must_use]
    pub const fn keeping(kept: usize) -> Self {
        Self { kept, messages: VecDeque::new(), done: 0 }
    }

    /// Takes messages.
    pub fn extend(&mut self, messages: &[Message<C>]) {
        let forgotten = self.done.saturating_sub(self.kept);
        self.messages.drain(..forgotten);
        self.done -= forgotten;
        self.messages.extend(messages);
    }

    /// The first message that is not worked through.
    #[must_use]
    pub fn next(&self) -> Option<&Message<C>> {
        self.messages.get(self.done)
    }

    /// That message is worked through.
    pub const fn advance(&mut self) {
        self.done += 1;
    }

    /// Lets go of what is older than a tick.
    pub fn forget_before(&mut self, tick: u64) {
        while self.messages.pop_front_if(|message| message.envelope.tick < tick).is_some() {
            self.done = self.done.saturating_sub(1);
        }
    }

    /// Tick of the newest message.
    #[must_use]
    pub fn newest_tick(&self) -> Option<u64> {
        self.messages.back().map(|message| message.envelope.tick)
    }

    /// What a stage had as its newest input, by the tick that it says this was of; none where that is not here.
    #[must_use]
    pub fn input(&self, input_tick: u64) -> Option<Dated<C>> {
        if input_tick == NO_TICK {
            return Some(Dated { tick: NO_TICK, content: C::default() });
        }
        let content = self.of(input_tick)?.content;
        Some(Dated { tick: input_tick, content })
    }

    /// The `count` messages up to the one of tick `last`; none where there are not so many.
    #[must_use]
    pub fn up_to(&self, last: u64, count: u64) -> Option<impl Iterator<Item = &Message<C>>> {
        let end = if count > 0 { self.place(last)? + 1 } else { 0 };
        let begin = end.checked_sub(usize::try_from(count).ok()?)?;
        Some(self.messages.range(begin..end))
    }

    /// The first `first` messages behind the one of tick `before`, and the `last` ones up to that of tick `until`; none
    /// where no message lies between the two.
    #[must_use]
    pub fn parted(&self, before: u64, first: u64, until: u64, last: u64) -> Option<impl Iterator<Item = &Message<C>>> {
        let begin = if before == NO_TICK { 0 } else { self.place(before)? + 1 };
        let head = begin..begin + usize::try_from(first).ok()?;
        let end = self.place(until)? + 1;
        let tail = end.checked_sub(usize::try_from(last).ok()?)?..end;
        (head.end < tail.start).then(|| self.messages.range(head).chain(self.messages.range(tail)))
    }

    /// The message of a tick.
    #[must_use]
    pub fn of(&self, tick: u64) -> Option<&Message<C>> {
        self.messages.get(self.place(tick)?)
    }

    fn place(&self, tick: u64) -> Option<usize> {
        // Where no tick was left out, the distance from the first one says it.
        let first = self.messages.front().map_or(0, |message| message.envelope.tick);
        let likely = usize::try_from(tick.wrapping_sub(first)).unwrap_or(usize::MAX);
        if self.messages.get(likely).is_some_and(|message| message.envelope.tick == tick) {
            return Some(likely);
        }
        self.messages.binary_search_by_key(&tick, |message| message.envelope.tick).ok()
    }
}
