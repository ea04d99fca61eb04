//! The recorded messages around the replayed tick, gaps in them, and what each stage had as its input.
//!
//! The log holds messages as they were sent, and for each output the ticks of its inputs. A fault's effect on a message
//! depends only on that message and earlier ones, so the fault filters of the inputs run again here. Lost and late messages
//! need no such treatment: they show in the ticks of the inputs.

use faults::fields::Faulty;
use faults::filter::FaultFilter;
use faults::{MessageFaults, Port};
use flight_log::entry::LogEntry;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::grid::Pace;
use messages::header::{Header, Message};
use messages::monitor::Monitor;
use messages::role::Role;
use messages::topic::Topic;

use errors::Failure;
use ipc::DEEP;
use messages::message_window::MessageWindow;
use sim::expected_messages::gap;

/// Messages kept behind the replayed one, per topic. An older input is possible only if its stage was stopped this long
/// between taking and using it.
const KEPT: usize = DEEP;
/// The same in lockstep, where no stage is ahead, if no fault withholds messages.
const KEPT_IN_LOCKSTEP: usize = 64;

#[derive(Clone, Debug)]
pub struct Inputs {
    pub states: MessageWindow<State>,
    pub setpoints: MessageWindow<Setpoint>,
    pub wrenches: MessageWindow<Wrench>,
    pub rotor_speeds: MessageWindow<RotorSpeeds>,
    pub theorem: MessageWindow<Monitor>,
    /// Whether the law has a theorem; the recorder then logs a monitor message per wrench.
    has_theorem: bool,
}

/// The next message to replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Next {
    pub tick: u64,
    pub stage: Role,
    /// Whether no unread message can be earlier or one of its inputs: each topic rises in ticks and has a message that is
    /// not earlier.
    pub is_settled: bool,
}

impl Inputs {
    pub fn new(has_theorem: bool, pace: Pace, faults: &MessageFaults) -> Self {
        let kept = match pace {
            Pace::Lockstep if faults.is_empty() => KEPT_IN_LOCKSTEP,
            _ => KEPT,
        };
        Self {
            states: MessageWindow::keeping(kept),
            setpoints: MessageWindow::keeping(kept),
            wrenches: MessageWindow::keeping(kept),
            rotor_speeds: MessageWindow::keeping(kept),
            theorem: MessageWindow::keeping(kept),
            has_theorem,
        }
    }

    /// Takes a message of the log. A swap is not replayed by itself.
    pub fn take(&mut self, entry: &LogEntry) {
        match entry {
            LogEntry::State(message) => self.states.push(*message),
            LogEntry::Setpoint(message) => self.setpoints.push(*message),
            LogEntry::Wrench(message) => self.wrenches.push(*message),
            LogEntry::RotorSpeeds(message) => self.rotor_speeds.push(*message),
            LogEntry::Theorem(message) => self.theorem.push(*message),
            LogEntry::Swap(_) => {}
        }
    }

    pub fn earliest(&self) -> Option<Next> {
        fn next<C: Topic>(window: &MessageWindow<C>) -> Option<&Header> {
            window.next().map(|message| &message.envelope)
        }
        let next = [
            (next(&self.states), Role::Plant),
            (next(&self.setpoints), Role::Outer),
            (next(&self.wrenches), Role::Inner),
            (next(&self.rotor_speeds), Role::Mixer),
            (next(&self.theorem), Role::Record),
        ];
        let goes_on = |(next, role): &(Option<&Header>, Role)| {
            next.is_some() || (*role == Role::Record && !self.has_theorem)
        };
        let all_go_on = next.iter().all(goes_on);
        let next = next
            .into_iter()
            .filter_map(|(next, role)| Some((next?, role)));
        let (header, stage) = next.min_by_key(|(next, role)| (next.tick, *role))?;
        let tick = header.tick;
        let is_earlier = |input: u64| input == NO_TICK || input <= tick;
        // Other stages may be ahead of a plant that was stopped.
        let goes_back = match (stage, self.states.next()) {
            (Role::Plant, Some(state)) => is_earlier(state.content.command_taken_tick),
            _ => header.input_tick.into_iter().all(is_earlier),
        };
        Some(Next {
            tick,
            stage,
            is_settled: all_go_on && goes_back,
        })
    }
}

pub fn of<C: Topic>(window: &MessageWindow<C>, tick: u64) -> Result<&Message<C>, Failure> {
    window.of(tick).ok_or_else(|| lacks::<C>(tick, tick))
}

/// What a stage had as its newest input at `tick`, by the tick that it says this was of.
pub fn input<C: Topic>(
    window: &MessageWindow<C>,
    input_tick: u64,
    tick: u64,
) -> Result<Stamped<C>, Failure> {
    window
        .input(input_tick)
        .ok_or_else(|| lacks::<C>(input_tick, tick))
}

/// The `count` messages up to the one of tick `last`, which a stage had taken by `tick`.
pub fn up_to<C: Topic>(
    window: &MessageWindow<C>,
    last: u64,
    count: u64,
    tick: u64,
) -> Result<impl Iterator<Item = &Message<C>>, Failure> {
    window.up_to(last, count).ok_or_else(|| {
        let name = C::NAME;
        gap(&format!(
            "at tick {tick} {count} more `{name}` up to that of tick {last} had been taken, which are not in it"
        ))
    })
}

fn lacks<C: Topic>(of_tick: u64, tick: u64) -> Failure {
    gap(&format!(
        "at tick {tick} the `{}` of tick {of_tick} was used, which is not in it",
        C::NAME
    ))
}

/// An input of a stage that is replayed.
#[derive(Clone, Debug)]
pub struct RecordedInput<C: Topic> {
    filter: Option<FaultFilter<C>>,
    /// The newest messages that passed the filter.
    passed: MessageWindow<C>,
}

impl<C: Faulty> RecordedInput<C> {
    pub fn new(faults: &MessageFaults, port: Port) -> Self {
        Self {
            filter: FaultFilter::new(faults, port),
            passed: MessageWindow::keeping(DEEP),
        }
    }

    pub fn take(&mut self, message: &Message<C>) {
        let Some(filter) = &mut self.filter else {
            return;
        };
        let tick = message.envelope.tick;
        if let Some(passed) = filter.pass(tick, &message.content) {
            self.passed.push(Message::of_tick(tick, passed.content));
            self.passed.advance();
        }
    }

    /// The newest input that the stage had at `tick`, identified by the tick it recorded.
    pub fn input(
        &self,
        messages: &MessageWindow<C>,
        input_tick: u64,
        tick: u64,
    ) -> Result<Stamped<C>, Failure> {
        let messages = self.filter.as_ref().map_or(messages, |_| &self.passed);
        input(messages, input_tick, tick)
    }
}

#[cfg(test)]
mod tests {
    use faults::filter::FaultyInput;
    use faults::{Kind, MessageFault, Span};

    use super::*;

    fn message<C: Topic>(tick: u64, input_tick: u64) -> Message<C> {
        let mut message = Message::of_tick(tick, C::default());
        message.envelope.input_tick = [input_tick; 3];
        message
    }

    fn inputs(has_theorem: bool) -> Inputs {
        Inputs::new(has_theorem, Pace::Lockstep, &MessageFaults::none(7))
    }

    /// The earliest of messages of tick 7 from every stage, unless they are changed: the tick of the state and of the
    /// command that the plant had taken, the tick of the setpoint and of its input, and whether the last two topics have
    /// a message.
    fn earliest(
        [state_tick, taken_tick]: [u64; 2],
        setpoint: Option<[u64; 2]>,
        has_monitor: bool,
        has_theorem: bool,
    ) -> Next {
        let mut inputs = inputs(has_theorem);
        let mut state = message::<State>(state_tick, NO_TICK);
        state.content.command_taken_tick = taken_tick;
        inputs.take(&LogEntry::State(state));
        if let Some([tick, input_tick]) = setpoint {
            inputs.take(&LogEntry::Setpoint(message(tick, input_tick)));
        }
        inputs.take(&LogEntry::Wrench(message(7, 7)));
        inputs.take(&LogEntry::RotorSpeeds(message(7, 7)));
        if has_monitor {
            inputs.take(&LogEntry::Theorem(message(7, 7)));
        }
        inputs.earliest().unwrap()
    }

    #[test]
    fn the_earliest_message_is_settled_once_every_topic_has_gone_on() {
        let (now, taken_later) = ([7, NO_TICK], [7, 9]);
        for (state, setpoint, has_monitor, has_theorem, stage, is_settled) in [
            (now, Some([7, 7]), true, true, Role::Plant, true),
            // Tick 7 has no setpoint.
            (now, Some([8, 7]), true, true, Role::Plant, true),
            (now, None, true, true, Role::Plant, false),
            (now, Some([7, 7]), false, true, Role::Plant, false),
            // A law without a theorem.
            (now, Some([7, 7]), false, false, Role::Plant, true),
            // The mixer was ahead of the plant, which had taken a later command.
            ([7, 6], Some([7, 7]), true, true, Role::Plant, true),
            (taken_later, Some([7, 7]), true, true, Role::Plant, false),
            // The setpoint is first, and was made from the state of its tick, or of a later one.
            ([9, NO_TICK], Some([7, 7]), true, true, Role::Outer, true),
            ([9, NO_TICK], Some([7, 8]), true, true, Role::Outer, false),
        ] {
            let next = Next {
                tick: 7,
                stage,
                is_settled,
            };
            assert_eq!(earliest(state, setpoint, has_monitor, has_theorem), next);
        }
        assert_eq!(inputs(false).earliest(), None);
    }

    const PORT: Port = Port::MixerWrench;

    /// The wrench of a tick: its thrust says which.
    fn wrench(tick: u64) -> Message<Wrench> {
        let mut message = message::<Wrench>(tick, NO_TICK);
        message.content.thrust_n = tick as f64;
        message
    }

    fn faults(kind: Kind, from: u64, to: u64) -> MessageFaults {
        let (mut faults, span) = (MessageFaults::none(7), Span { from, to });
        let port = PORT;
        faults
            .take(&MessageFault { port, kind, span }.into())
            .unwrap();
        faults
    }

    #[test]
    fn finds_inputs_as_received_and_reports_impossible_ones_as_gaps() {
        let mut input_with_faults = RecordedInput::new(&faults(Kind::Freeze, 2, 5), PORT);
        (0..7).for_each(|tick| input_with_faults.take(&wrench(tick)));
        let none = MessageWindow::keeping(1);
        let thrust = |input_tick| {
            let input = input_with_faults.input(&none, input_tick, 9).ok()?;
            Some(input.content.thrust_n)
        };
        assert_eq!(
            [NO_TICK, 1, 1, 3, 6].map(thrust),
            [Some(0.0), Some(1.0), Some(1.0), Some(1.0), Some(6.0)]
        );
        assert_eq!(thrust(8), None);
    }

    #[test]
    fn a_stage_restarted_within_a_fault_has_what_its_replay_finds_whatever_is_injected_later() {
        for faults in [Kind::Freeze, Kind::Lag(3)].map(|kind| faults(kind, 2, 9)) {
            let mut replayed = RecordedInput::new(&faults, PORT);
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
                let found = replayed.input(&MessageWindow::keeping(1), had.tick, tick);
                assert_eq!(found.ok(), Some(had), "tick {tick}");
            }
        }
    }
}
