//! The recorded messages that later ones were computed from, and what each stage had as its input.
//!
//! The log holds messages as they were sent, and for each output the ticks of its inputs. A fault's effect on a message
//! depends only on that message and earlier ones, so the fault filters of the inputs run again here. Lost and late messages
//! need no such treatment: they show in the ticks of the inputs.

use faults::filter::{FaultFilter, Passed};
use faults::plan::Planned;
use faults::{MessageFaults, Port};
use messages::content::Stamped;
use messages::fields::Faulty;
use messages::grid::Pace;
use messages::header::Message;
use messages::history::UNDISTURBED;
use messages::message_window::MessageWindow;
use messages::topic::Topic;

use errors::Failure;
use ipc::DEEP;
use sim::expected_messages::gap;

/// Messages of a topic that are kept. An older input is possible only if its stage was stopped this long between taking and
/// using it; in lockstep the other stages wait for it, and only a fault has a stage work with an old message.
pub fn kept(pace: Pace, planned: &Planned) -> usize {
    match pace {
        Pace::Lockstep if planned.has_no_loop_faults() => 16,
        _ => DEEP,
    }
}

fn lacks<C: Topic>(of_tick: u64, tick: u64) -> Failure {
    gap(&format!(
        "at tick {tick} the `{}` of tick {of_tick} was used, which is not in it",
        C::NAME
    ))
}

/// An input of a stage that is replayed: the messages of a topic that its port let through, as a fault left them.
#[derive(Clone, Debug)]
pub struct RecordedInput<C: Topic> {
    /// With faults, the messages that passed; without, all messages did.
    faulty: Option<(FaultFilter<C>, MessageWindow<C>)>,
}

impl<C: Faulty> RecordedInput<C> {
    pub fn new(faults: &MessageFaults, port: Port, kept: usize) -> Self {
        let filter = FaultFilter::new(faults, port);
        Self {
            faulty: filter.map(|filter| (filter, MessageWindow::keeping(kept))),
        }
    }

    pub const fn has_faults(&self) -> bool {
        self.faulty.is_some()
    }

    pub fn take(&mut self, message: &Message<C>) {
        if let Some((filter, passed)) = &mut self.faulty
            && let Some(Passed { content, .. }) =
                filter.pass(message.envelope.tick, &message.content)
        {
            let envelope = message.envelope;
            passed.push(&Message { envelope, content });
        }
    }

    fn passed<'a>(&'a self, all: &'a MessageWindow<C>) -> &'a MessageWindow<C> {
        self.faulty.as_ref().map_or(all, |(_, passed)| passed)
    }

    /// The newest input that the stage had at `tick`, identified by the tick that its message names; `all` are the messages
    /// of the topic.
    pub fn input<'a>(
        &'a self,
        all: &'a MessageWindow<C>,
        input_tick: u64,
        tick: u64,
    ) -> Result<&'a Stamped<C>, Failure> {
        let input = self.passed(all).input(input_tick);
        input.ok_or_else(|| lacks::<C>(input_tick, tick))
    }

    /// Tick of an input, and the history of the state that its sender had after it.
    pub fn history(&self, all: &MessageWindow<C>, input_tick: u64) -> (u64, u64) {
        let message = self.passed(all).of(input_tick);
        let after = message.map_or(UNDISTURBED, |(header, _)| header.law_state.after);
        (input_tick, after)
    }
}

#[cfg(test)]
mod tests {
    use faults::filter::FaultyInput;
    use faults::grammar::Fault;
    use messages::content::{NO_TICK, Wrench};
    use messages::parameters::Airframe;

    use super::*;

    const PORT: Port = Port::MixerWrench;

    /// The wrench of a tick: its thrust says which.
    fn wrench(tick: u64) -> Message<Wrench> {
        let thrust_n = tick as f64;
        let content = Wrench {
            thrust_n,
            ..Wrench::default()
        };
        Message::of_tick(tick, content)
    }

    fn faults(text: &str) -> MessageFaults {
        let fault: Fault = text.parse().unwrap();
        let planned = Planned::new(&[fault], 1e-3, &Airframe::nominal(), 7);
        planned.unwrap().loops.messages
    }

    #[test]
    fn finds_inputs_as_received_and_reports_impossible_ones_as_gaps() {
        let mut input_with_faults =
            RecordedInput::new(&faults("wrench.freeze@tick2..tick5"), PORT, DEEP);
        (0..7).for_each(|tick| input_with_faults.take(&wrench(tick)));
        let all = MessageWindow::keeping(DEEP);
        let mut thrust = |input_tick| {
            let input = input_with_faults.input(&all, input_tick, 9).ok()?;
            Some(input.content.thrust_n)
        };
        assert_eq!(
            [NO_TICK, 1, 1, 3, 6].map(&mut thrust),
            [Some(0.0), Some(1.0), Some(1.0), Some(1.0), Some(6.0)]
        );
        assert_eq!(thrust(8), None);
    }

    #[test]
    fn a_stage_restarted_within_a_fault_has_what_its_replay_finds_whatever_is_injected_later() {
        for text in ["wrench.freeze@tick2..tick9", "wrench.lag=3@tick2..tick9"] {
            let faults = faults(text);
            let mut replayed = RecordedInput::new(&faults, PORT, DEEP);
            (0..4).for_each(|tick| replayed.take(&wrench(tick)));
            let mut restarted = FaultyInput::changing(&MessageFaults::none(7), PORT);
            restarted.change(&faults, PORT, &Message::default());
            for tick in 4..12 {
                if tick == 6 {
                    restarted.change(&faults, PORT, &wrench(tick - 1));
                }
                replayed.take(&wrench(tick));
                restarted.arrive(&wrench(tick));
                restarted.settle(tick);
                let had = restarted.stamped();
                let all = MessageWindow::keeping(DEEP);
                let found = replayed.input(&all, had.tick, tick);
                assert_eq!(found.ok().copied(), Some(had), "tick {tick}");
            }
        }
    }
}
