//! The newest messages of a topic, to find the inputs of later messages.

use std::collections::VecDeque;

use crate::content::{NO_TICK, Stamped};
use crate::header::Message;
use crate::topic::Topic;

/// Messages of a topic in ascending order of ticks, and how many of them have been processed.
#[derive(Clone, Debug)]
pub struct MessageWindow<C: Topic> {
    kept: usize,
    messages: VecDeque<Message<C>>,
    done: usize,
}

impl<C: Topic> MessageWindow<C> {
    /// An empty window that keeps `kept` processed messages.
    pub const fn keeping(kept: usize) -> Self {
        Self {
            kept,
            messages: VecDeque::new(),
            done: 0,
        }
    }

    pub fn push(&mut self, message: Message<C>) {
        let forgotten = self.done.saturating_sub(self.kept);
        self.messages.drain(..forgotten);
        self.done -= forgotten;
        if forgotten > self.kept && self.messages.len() == self.done {
            // To the beginning of its memory, which is in the cache, rather than once around all of it.
            let kept: Vec<_> = self.messages.drain(..).collect();
            self.messages.extend(kept);
        }
        self.messages.push_back(message);
    }

    /// The first message that has not been processed.
    pub fn next(&self) -> Option<&Message<C>> {
        self.messages.get(self.done)
    }

    pub const fn advance(&mut self) {
        self.done += 1;
    }

    /// Drops messages older than a tick.
    pub fn forget_before(&mut self, tick: u64) {
        while self
            .messages
            .pop_front_if(|message| message.envelope.tick < tick)
            .is_some()
        {
            self.done = self.done.saturating_sub(1);
        }
    }

    pub fn newest_tick(&self) -> Option<u64> {
        self.messages.back().map(|message| message.envelope.tick)
    }

    /// The input of a stage, by the tick that the stage reports; none if that message is not in the window.
    pub fn input(&self, input_tick: u64) -> Option<Stamped<C>> {
        if input_tick == NO_TICK {
            return Some(Stamped::never());
        }
        Some(Stamped::new(input_tick, self.of(input_tick)?.content))
    }

    /// The `count` messages up to tick `last`; none if there are fewer.
    pub fn up_to(&self, last: u64, count: u64) -> Option<impl Iterator<Item = &Message<C>>> {
        let end = if count > 0 { self.place(last)? + 1 } else { 0 };
        let begin = end.checked_sub(usize::try_from(count).ok()?)?;
        Some(self.messages.range(begin..end))
    }

    /// The first `first` messages after tick `before`, and the `last` messages up to tick `until`; none if no message lies
    /// between the two groups.
    pub fn parted(
        &self,
        before: u64,
        first: u64,
        until: u64,
        last: u64,
    ) -> Option<impl Iterator<Item = &Message<C>>> {
        let begin = if before == NO_TICK {
            0
        } else {
            self.place(before)? + 1
        };
        let head = begin..begin + usize::try_from(first).ok()?;
        let end = self.place(until)? + 1;
        let tail = end.checked_sub(usize::try_from(last).ok()?)?..end;
        (head.end < tail.start).then(|| self.messages.range(head).chain(self.messages.range(tail)))
    }

    pub fn of(&self, tick: u64) -> Option<&Message<C>> {
        self.messages.get(self.place(tick)?)
    }

    fn place(&self, tick: u64) -> Option<usize> {
        let tick_of = |message: &Message<C>| message.envelope.tick;
        // Without gaps, the distance from the first tick is the index.
        let first = self.messages.front().map_or(0, tick_of);
        let likely = usize::try_from(tick.wrapping_sub(first)).unwrap_or(usize::MAX);
        if self.messages.get(likely).map(tick_of) == Some(tick) {
            return Some(likely);
        }
        self.messages.binary_search_by_key(&tick, tick_of).ok()
    }
}
