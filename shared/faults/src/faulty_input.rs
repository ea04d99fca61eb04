//! An input with faults: the gate, the messages that it holds back, and the newest that the stage has.

use std::collections::VecDeque;

use crate::fields::Faulty;
use crate::gate::{Gate, Passed};
use crate::{LONGEST_DELAY, MessageFaults, Port};
use messages::content::{NO_TICK, Stamped};
use messages::header::Message;
use messages::rejections::Rejections;

/// Messages that may be held back: one a tick, for the longest delay, and the newest.
const ROOM: usize = LONGEST_DELAY as usize + 4;

/// What stands between an inspected message and the stage that it is for.
///
/// Show it every message with [`FaultyInput::arrive`], and ask it with [`FaultyInput::settle`] at every tick that the stage works.
#[derive(Clone, Debug)]
pub struct FaultyInput<C: Faulty> {
    gate: Option<Gate<C>>,
    /// Those that come later, each with the first tick that has it.
    waiting: VecDeque<(u64, Message<C>)>,
    newest: Message<C>,
}

impl<C: Faulty> FaultyInput<C> {
    /// An input that nothing has come to.
    pub fn new(faults: &MessageFaults, port: Port) -> Self {
        Self {
            gate: Gate::new(faults, port),
            waiting: VecDeque::with_capacity(ROOM),
            newest: Message::default(),
        }
    }

    /// An input that nothing has come to, and whose faults may change in flight.
    pub fn changing(faults: &MessageFaults, port: Port) -> Self {
        let mut inlet = Self::new(&MessageFaults::none(faults.seed), port);
        // Memory that was never touched is none yet.
        inlet
            .waiting
            .extend((0..ROOM).map(|_| (0, Message::default())));
        inlet.waiting.clear();
        Self {
            gate: Some(Gate::changing(faults, port)),
            ..inlet
        }
    }

    /// Takes the faults as they are from now on, without an allocation; `newest` is what came last, whether it was shown
    /// that or not.
    pub fn change(&mut self, faults: &MessageFaults, port: Port, newest: &Message<C>) {
        if let Some(gate) = &mut self.gate {
            gate.change(
                faults,
                port,
                (newest.envelope.tick != NO_TICK).then_some(newest.content),
            );
        }
        if self.newest.envelope.tick == NO_TICK && self.waiting.is_empty() {
            self.newest = *newest;
        }
    }

    /// Takes a message that inspection let through. It keeps its envelope, whatever becomes of its content.
    pub fn arrive(&mut self, message: &Message<C>) {
        self.arrive_late(message, 0);
    }

    /// The same of a message that its sender was so many ticks late with.
    pub fn arrive_late(&mut self, message: &Message<C>, late: u64) {
        let (envelope, tick) = (message.envelope, message.envelope.tick);
        let passed = match &mut self.gate {
            Some(gate) => gate.pass(tick, &message.content),
            None => Some(Passed {
                content: message.content,
                delay: 0,
            }),
        };
        let Some(Passed { content, delay }) = passed else {
            return;
        };
        if self.waiting.len() == ROOM {
            self.waiting.pop_front();
        }
        self.waiting.push_back((
            tick.saturating_add(delay).saturating_add(late),
            Message { envelope, content },
        ));
    }

    /// The newest message that has come by a tick. One that was overtaken on its way is never used.
    pub fn settle(&mut self, tick: u64) -> &Message<C> {
        let Self {
            waiting, newest, ..
        } = self;
        waiting.retain(|(due, message)| {
            let is_due = *due <= tick;
            if is_due
                && (newest.envelope.tick == NO_TICK || newest.envelope.tick < message.envelope.tick)
            {
                *newest = *message;
            }
            !is_due
        });
        newest
    }

    /// The newest message that the stage has.
    pub const fn newest(&self) -> &Message<C> {
        &self.newest
    }

    pub const fn dated(&self) -> Stamped<C> {
        Stamped::new(self.newest.envelope.tick, self.newest.content)
    }

    /// Messages that were refused for what a fault had made of them.
    pub fn rejections(&self) -> Rejections {
        self.gate
            .as_ref()
            .map(|gate| *gate.rejections())
            .unwrap_or_default()
    }
}
