//! Recorded messages as their receiver got them, after the fault filter of its input.
//!
//! The log holds messages as they were sent, and for each output the ticks of its inputs. A fault's effect on a message
//! depends only on that message and earlier ones, so it is computed again here. Lost and late messages need no such
//! treatment: they show in the ticks of the inputs.

use std::collections::VecDeque;

use ipc::DEEP;
use messages::content::{NO_TICK, Stamped};
use messages::fault::fields::Faulty;
use messages::fault::gate::Gate;
use messages::fault::{MessageFaults, Port};
use messages::header::Message;

use crate::message_window::MessageWindow;
use crate::replay::inputs::{input, lacks};
use errors::Failure;

/// An input of a stage that is replayed.
#[derive(Clone, Debug)]
pub struct RecordedInput<C> {
    gate: Option<Gate<C>>,
    /// Messages that passed the filter and were not used yet.
    passed: VecDeque<Stamped<C>>,
    used: Stamped<C>,
}

impl<C: Faulty> RecordedInput<C> {
    /// An input that has received nothing.
    #[must_use]
    pub fn new(faults: &MessageFaults, port: Port) -> Self {
        let used = Stamped {
            tick: NO_TICK,
            content: C::default(),
        };
        Self {
            gate: Gate::new(faults, port),
            passed: VecDeque::new(),
            used,
        }
    }

    /// Takes the next message of the topic.
    pub fn take(&mut self, message: &Message<C>) {
        let Some(gate) = &mut self.gate else { return };
        let tick = message.envelope.tick;
        if let Some(passed) = gate.pass(tick, &message.content) {
            if self.passed.len() == DEEP {
                self.passed.pop_front();
            }
            self.passed.push_back(Stamped {
                tick,
                content: passed.content,
            });
        }
    }

    /// The newest input that the stage had at `tick`, identified by the tick it recorded.
    pub fn input(
        &mut self,
        messages: &MessageWindow<C>,
        input_tick: u64,
        tick: u64,
    ) -> Result<Stamped<C>, Failure> {
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
    use messages::content::Wrench;
    use messages::fault::{Kind, MessageFault, Span};
    use messages::header::Header;

    use super::*;

    fn wrench(tick: u64) -> Message<Wrench> {
        let content = Wrench {
            thrust_n: tick as f64,
            ..Wrench::default()
        };
        Message {
            envelope: Header {
                tick,
                ..Header::new()
            },
            content,
        }
    }

    #[test]
    fn finds_inputs_as_received_and_reports_impossible_ones_as_gaps() {
        let mut faults = MessageFaults::none(7);
        let span = Span { from: 2, to: 5 };
        faults
            .push(MessageFault {
                port: Port::MixerWrench,
                kind: Kind::Freeze,
                span,
            })
            .unwrap();
        let mut input_with_faults = RecordedInput::new(&faults, Port::MixerWrench);
        let none = MessageWindow::keeping(1);
        (0..7).for_each(|tick| input_with_faults.take(&wrench(tick)));
        let mut thrust = |input_tick| {
            input_with_faults
                .input(&none, input_tick, 9)
                .map(|dated| dated.content.thrust_n)
                .ok()
        };
        assert_eq!(
            [NO_TICK, 1, 1, 3, 6].map(&mut thrust),
            [Some(0.0), Some(1.0), Some(1.0), Some(1.0), Some(6.0)]
        );
        assert_eq!(thrust(8), None);
    }
}
