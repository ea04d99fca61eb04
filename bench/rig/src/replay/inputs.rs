//! The recorded messages around the replayed tick, and gaps in them.

use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::role::Role;
use messages::topic::Topic;

use crate::message_window::MessageWindow;
use crate::replay::batches::Batch;
use crate::replay::log_check::gap;
use errors::Failure;
use ipc::DEEP;

/// Messages kept behind the replayed one, per topic. An older input is possible only if its stage was stopped this long
/// between taking and using it.
const KEPT: usize = DEEP;

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

impl Inputs {
    #[must_use]
    pub const fn new(has_theorem: bool) -> Self {
        Self {
            states: MessageWindow::keeping(KEPT),
            setpoints: MessageWindow::keeping(KEPT),
            wrenches: MessageWindow::keeping(KEPT),
            rotor_speeds: MessageWindow::keeping(KEPT),
            theorem: MessageWindow::keeping(KEPT),
            has_theorem,
        }
    }

    /// Takes messages of the log and returns how many of them have to be replayed.
    pub fn take(&mut self, batch: &Batch) -> usize {
        let Batch {
            states,
            setpoints,
            wrenches,
            rotor_speeds,
            theorem,
            ..
        } = batch;
        self.states.extend(states);
        self.setpoints.extend(setpoints);
        self.wrenches.extend(wrenches);
        self.rotor_speeds.extend(rotor_speeds);
        self.theorem.extend(theorem);
        states.len() + setpoints.len() + wrenches.len() + rotor_speeds.len() + theorem.len()
    }

    /// The earliest message not replayed yet.
    #[must_use]
    pub fn earliest(&self) -> Option<Next> {
        let next = [
            (next_tick(&self.states), Role::Plant),
            (next_tick(&self.setpoints), Role::Outer),
            (next_tick(&self.wrenches), Role::Inner),
            (next_tick(&self.rotor_speeds), Role::Mixer),
            (next_tick(&self.theorem), Role::Record),
        ];
        let goes_on = |(tick, role): &(Option<u64>, Role)| {
            tick.is_some() || (*role == Role::Record && !self.has_theorem)
        };
        let all_go_on = next.iter().all(goes_on);
        let (tick, stage) = next
            .into_iter()
            .filter_map(|(tick, role)| Some((tick?, role)))
            .min()?;
        Some(Next {
            tick,
            stage,
            is_settled: all_go_on && self.goes_back(tick, stage),
        })
    }

    /// Whether the next message of a stage used only inputs of this or earlier ticks.
    fn goes_back(&self, tick: u64, stage: Role) -> bool {
        let earlier = |input: u64| input == NO_TICK || input <= tick;
        let inputs = match stage {
            // Other stages may be ahead of a plant that was stopped.
            Role::Plant => {
                return self
                    .states
                    .next()
                    .is_some_and(|state| earlier(state.content.command_taken_tick));
            }
            Role::Outer => self
                .setpoints
                .next()
                .map(|message| message.envelope.input_tick),
            Role::Inner => self
                .wrenches
                .next()
                .map(|message| message.envelope.input_tick),
            Role::Mixer => self
                .rotor_speeds
                .next()
                .map(|message| message.envelope.input_tick),
            Role::Record => self
                .theorem
                .next()
                .map(|message| message.envelope.input_tick),
        };
        inputs.is_some_and(|inputs| inputs.into_iter().all(earlier))
    }
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

fn next_tick<C: Topic>(window: &MessageWindow<C>) -> Option<u64> {
    window.next().map(|message| message.envelope.tick)
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

pub(super) fn lacks<C: Topic>(of_tick: u64, tick: u64) -> Failure {
    gap(&format!(
        "at tick {tick} the `{}` of tick {of_tick} was used, which is not in it",
        C::NAME
    ))
}

#[cfg(test)]
mod tests {
    use messages::header::Header;

    use super::*;

    fn message<C: Topic>(tick: u64, input_tick: u64) -> Message<C> {
        let envelope = Header {
            tick,
            input_tick: [input_tick; 3],
            ..Header::new()
        };
        Message {
            envelope,
            content: C::default(),
        }
    }

    fn state(tick: u64, command_taken_tick: u64) -> Message<State> {
        let content = State {
            command_taken_tick,
            ..State::default()
        };
        Message {
            content,
            ..message(tick, NO_TICK)
        }
    }

    /// Messages of tick 7 from every stage, and what was said of it; changed by `change`.
    fn earliest(has_theorem: bool, change: fn(&mut Batch)) -> Option<Next> {
        let mut batch = Batch::default();
        batch.states.push(state(7, NO_TICK));
        batch.setpoints.push(message(7, 7));
        batch.wrenches.push(message(7, 7));
        batch.rotor_speeds.push(message(7, 7));
        batch.theorem.push(message(7, 7));
        change(&mut batch);
        let mut inputs = Inputs::new(has_theorem);
        inputs.take(&batch);
        inputs.earliest()
    }

    /// The plant had taken the command of this tick.
    fn took(batch: &mut Batch, tick: u64) {
        batch.states[0].content.command_taken_tick = tick;
    }

    /// The set-point comes first, and was made from the state of this tick.
    fn without_state(batch: &mut Batch, input_tick: u64) {
        batch.states[0].envelope.tick = 9;
        batch.setpoints[0].envelope.input_tick[0] = input_tick;
    }

    #[test]
    fn the_earliest_message_is_settled_once_every_topic_has_gone_on() {
        let settled = |is_settled| {
            Some(Next {
                tick: 7,
                stage: Role::Plant,
                is_settled,
            })
        };
        assert_eq!(earliest(true, |_| ()), settled(true));
        assert_eq!(
            earliest(true, |batch| batch.setpoints[0].envelope.tick = 8),
            settled(true),
            "7 has no set-point"
        );
        assert_eq!(
            earliest(true, |batch| batch.setpoints.clear()),
            settled(false)
        );
        assert_eq!(
            earliest(true, |batch| batch.theorem.clear()),
            settled(false)
        );
        assert_eq!(
            earliest(false, |batch| batch.theorem.clear()),
            settled(true),
            "a law without a theorem"
        );
        assert_eq!(earliest(false, |batch| *batch = Batch::default()), None);
    }

    #[test]
    fn what_goes_back_to_a_later_tick_is_not_settled_by_its_own() {
        let settled = |stage, is_settled| {
            Some(Next {
                tick: 7,
                stage,
                is_settled,
            })
        };
        assert_eq!(
            earliest(true, |batch| took(batch, 6)),
            settled(Role::Plant, true)
        );
        assert_eq!(
            earliest(true, |batch| took(batch, 9)),
            settled(Role::Plant, false),
            "the mixer was further on"
        );
        assert_eq!(
            earliest(true, |batch| without_state(batch, 7)),
            settled(Role::Outer, true)
        );
        assert_eq!(
            earliest(true, |batch| without_state(batch, 8)),
            settled(Role::Outer, false)
        );
    }
}
