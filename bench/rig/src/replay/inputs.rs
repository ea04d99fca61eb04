//! The recorded messages around the tick that is replayed, and what the log lacks of them.

use model::envelope::Message;
use model::messages::{Dated, NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use model::role::Role;
use model::topic::Topic;

use crate::replay::batches::Batch;
use crate::replay::survey::gap;
use crate::window::Window;
use failure::Failure;
use wire::DEEP;

/// Messages of a topic that are kept behind the one that is replayed. An input is the newest that its stage had: so many
/// can be newer only where a process was stopped for as long between taking it and using it.
const KEPT: usize = DEEP;

/// A window per topic.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// Topic `state`.
    pub states: Window<State>,
    /// Topic `setpoint`.
    pub setpoints: Window<Setpoint>,
    /// Topic `wrench`.
    pub wrenches: Window<Wrench>,
    /// Topic `rotor_speeds`.
    pub rotor_speeds: Window<RotorSpeeds>,
    /// Topic `theorem`.
    pub theorem: Window<Monitor>,
    /// Whether the flight's law has a theorem, of which the recorder then says something at every wrench.
    has_theorem: bool,
}

impl Inputs {
    /// Nothing so far, of a flight whose law has a theorem or has none.
    #[must_use]
    pub const fn new(has_theorem: bool) -> Self {
        Self {
            states: Window::keeping(KEPT),
            setpoints: Window::keeping(KEPT),
            wrenches: Window::keeping(KEPT),
            rotor_speeds: Window::keeping(KEPT),
            theorem: Window::keeping(KEPT),
            has_theorem,
        }
    }

    /// Takes messages of the log; how many are to be replayed.
    pub fn take(&mut self, batch: &Batch) -> usize {
        let Batch { states, setpoints, wrenches, rotor_speeds, theorem, .. } = batch;
        self.states.extend(states);
        self.setpoints.extend(setpoints);
        self.wrenches.extend(wrenches);
        self.rotor_speeds.extend(rotor_speeds);
        self.theorem.extend(theorem);
        states.len() + setpoints.len() + wrenches.len() + rotor_speeds.len() + theorem.len()
    }

    /// The earliest message that is not replayed yet.
    #[must_use]
    pub fn earliest(&self) -> Option<Next> {
        let next = [
            (next_tick(&self.states), Role::Plant),
            (next_tick(&self.setpoints), Role::Outer),
            (next_tick(&self.wrenches), Role::Inner),
            (next_tick(&self.rotor_speeds), Role::Mixer),
            (next_tick(&self.theorem), Role::Record),
        ];
        let goes_on =
            |(tick, role): &(Option<u64>, Role)| tick.is_some() || (*role == Role::Record && !self.has_theorem);
        let all_go_on = next.iter().all(goes_on);
        let (tick, stage) = next.into_iter().filter_map(|(tick, role)| Some((tick?, role))).min()?;
        Some(Next { tick, stage, is_settled: all_go_on && self.goes_back(tick, stage) })
    }

    /// Whether the next message of a stage was made from nothing of a later tick.
    fn goes_back(&self, tick: u64, stage: Role) -> bool {
        let earlier = |input: u64| input == NO_TICK || input <= tick;
        let inputs = match stage {
            // Others may be further on than a plant that was stopped.
            Role::Plant => return self.states.next().is_some_and(|state| earlier(state.content.command_taken_tick)),
            Role::Outer => self.setpoints.next().map(|message| message.envelope.input_tick),
            Role::Inner => self.wrenches.next().map(|message| message.envelope.input_tick),
            Role::Mixer => self.rotor_speeds.next().map(|message| message.envelope.input_tick),
            Role::Record => self.theorem.next().map(|message| message.envelope.input_tick),
        };
        inputs.is_some_and(|inputs| inputs.into_iter().all(earlier))
    }
}

/// A message that is to be replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Next {
    /// Its tick.
    pub tick: u64,
    /// Its sender.
    pub stage: Role,
    /// Whether nothing that is still to come can be earlier, or is what it was made from: every topic is by rising
    /// ticks, and each has a message that is not earlier.
    pub is_settled: bool,
}

fn next_tick<C: Topic>(window: &Window<C>) -> Option<u64> {
    window.next().map(|message| message.envelope.tick)
}

/// The message of a tick.
///
/// # Errors
/// [`Failure`] where the log has none.
pub fn of<C: Topic>(window: &Window<C>, tick: u64) -> Result<&Message<C>, Failure> {
    window.of(tick).ok_or_else(|| lacks::<C>(tick, tick))
}

/// What a stage had as its newest input at `tick`, by the tick that it says this was of.
///
/// # Errors
/// [`Failure`] where the log has no such message.
pub fn input<C: Topic>(window: &Window<C>, input_tick: u64, tick: u64) -> Result<Dated<C>, Failure> {
    window.input(input_tick).ok_or_else(|| lacks::<C>(input_tick, tick))
}

/// The `count` messages up to the one of tick `last`, which a stage had taken by `tick`.
///
/// # Errors
/// [`Failure`] where the log has not so many.
pub fn up_to<C: Topic>(
    window: &Window<C>,
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
    gap(&format!("at tick {tick} the `{}` of tick {of_tick} was used, which is not in it", C::NAME))
}

#[cfg(test)]
mod tests {
    use model::envelope::Envelope;

    use super::*;

    fn message<C: Topic>(tick: u64, input_tick: u64) -> Message<C> {
        let envelope = Envelope { tick, input_tick: [input_tick; 3], ..Envelope::new() };
        Message { envelope, content: C::default() }
    }

    fn state(tick: u64, command_taken_tick: u64) -> Message<State> {
        let content = State { command_taken_tick, ..State::default() };
        Message { content, ..message(tick, NO_TICK) }
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
        let settled = |is_settled| Some(Next { tick: 7, stage: Role::Plant, is_settled });
        assert_eq!(earliest(true, |_| ()), settled(true));
        assert_eq!(earliest(true, |batch| batch.setpoints[0].envelope.tick = 8), settled(true), "7 has no set-point");
        assert_eq!(earliest(true, |batch| batch.setpoints.clear()), settled(false));
        assert_eq!(earliest(true, |batch| batch.theorem.clear()), settled(false));
        assert_eq!(earliest(false, |batch| batch.theorem.clear()), settled(true), "a law without a theorem");
        assert_eq!(earliest(false, |batch| *batch = Batch::default()), None);
    }

    #[test]
    fn what_goes_back_to_a_later_tick_is_not_settled_by_its_own() {
        let settled = |stage, is_settled| Some(Next { tick: 7, stage, is_settled });
        assert_eq!(earliest(true, |batch| took(batch, 6)), settled(Role::Plant, true));
        assert_eq!(earliest(true, |batch| took(batch, 9)), settled(Role::Plant, false), "the mixer was further on");
        assert_eq!(earliest(true, |batch| without_state(batch, 7)), settled(Role::Outer, true));
        assert_eq!(earliest(true, |batch| without_state(batch, 8)), settled(Role::Outer, false));
    }
}
