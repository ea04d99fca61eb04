//! Recorded messages as their receiver had them: behind the gate of an input with faults.
//!
//! The log has messages as they were sent, and says of each output which tick its inputs were of. What a fault made of a
//! message follows from that message and from those before it, so it is made again here. What was lost or late needs
//! no second look: it shows in the ticks of the inputs.

use std::collections::VecDeque;

use model::envelope::Message;
use model::fault::fields::Faulty;
use model::fault::gate::Gate;
use model::fault::{MessageFaults, Port};
use model::messages::{Dated, NO_TICK};
use wire::DEEP;

use crate::replay::inputs::{input, lacks};
use crate::window::Window;
use failure::Failure;

/// An input of a stage that is replayed.
#[derive(Clone, Debug)]
pub struct Struck<C> {
    gate: Option<Gate<C>>,
    /// What passed it, and was not looked for yet.
    passed: VecDeque<Dated<C>>,
    /// What was used last.
    used: Dated<C>,
}

impl<C: Faulty> Struck<C> {
    /// An input that nothing has come to.
    #[must_use]
    pub fn new(faults: &MessageFaults, port: Port) -> Self {
        let used = Dated { tick: NO_TICK, content: C::default() };
        Self { gate: Gate::new(faults, port), passed: VecDeque::new(), used }
    }

    /// Takes the next message of the topic.
    pub fn take(&mut self, message: &Message<C>) {
        let Some(gate) = &mut self.gate else { return };
        let tick = message.envelope.tick;
        if let Some(passed) = gate.pass(tick, &message.content) {
            if self.passed.len() == DEEP {
                self.passed.pop_front();
            }
            self.passed.push_back(Dated { tick, content: passed.content });
        }
    }

    /// What the stage had as its newest input at `tick`, by the tick that it says this was of.
    ///
    /// # Errors
    /// [`Failure`] where the log has no such message.
    pub fn input(&mut self, messages: &Window<C>, input_tick: u64, tick: u64) -> Result<Dated<C>, Failure> {
        if self.gate.is_none() || input_tick == NO_TICK {
            return input(messages, input_tick, tick);
        }
        while self.used.tick != input_tick {
            let next = self.passed.pop_front_if(|passed| passed.tick <= input_tick);
            self.used = next.ok_or_else(|| lacks::<C>(input_tick, tick))?;
        }
        Ok(self.used)
    }
}

#[cfg(test)]
mod tests {
    use model::envelope::Envelope;
    use model::fault::{Kind, MessageFault, Span};
    use model::messages::Wrench;

    use super::*;

    fn wrench(tick: u64) -> Message<Wrench> {
        let content = Wrench { thrust_n: tick as f64, ..Wrench::default() };
        Message { envelope: Envelope { tick, ..Envelope::new() }, content }
    }

    #[test]
    fn an_input_is_found_as_its_stage_had_it_and_one_that_cannot_have_been_is_a_gap() {
        let mut faults = MessageFaults::none(7);
        let span = Span { from: 2, to: 5 };
        faults.push(MessageFault { port: Port::MixerWrench, kind: Kind::Freeze, span }).unwrap();
        let mut struck = Struck::new(&faults, Port::MixerWrench);
        let none = Window::keeping(1);
        (0..7).for_each(|tick| struck.take(&wrench(tick)));
        let mut thrust = |input_tick| struck.input(&none, input_tick, 9).map(|dated| dated.content.thrust_n).ok();
        assert_eq!([NO_TICK, 1, 1, 3, 6].map(&mut thrust), [Some(0.0), Some(1.0), Some(1.0), Some(1.0), Some(6.0)]);
        assert_eq!(thrust(8), None);
    }
}
