//! The recorded messages around the tick that is replayed, and what the log lacks of them.

use model::envelope::Message;
use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use model::role::Role;
use model::topic::Topic;

use crate::replay::LOOKAHEAD;
use crate::replay::batches::Batch;
use crate::replay::survey::gap;
use crate::window::Window;
use failure::Failure;

/// Messages kept behind the one that is replayed. An input is the newest that its stage had; that is never so old.
const KEPT: usize = LOOKAHEAD;

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
}

impl Inputs {
    /// Nothing so far.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            states: Window::keeping(KEPT),
            setpoints: Window::keeping(KEPT),
            wrenches: Window::keeping(KEPT),
            rotor_speeds: Window::keeping(KEPT),
            theorem: Window::keeping(KEPT),
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

    /// Tick and sender of the earliest message that is not replayed yet.
    #[must_use]
    pub fn earliest(&self) -> Option<(u64, Role)> {
        let next = [
            (next_tick(&self.states), Role::Plant),
            (next_tick(&self.setpoints), Role::Outer),
            (next_tick(&self.wrenches), Role::Inner),
            (next_tick(&self.rotor_speeds), Role::Mixer),
            (next_tick(&self.theorem), Role::Record),
        ];
        next.into_iter().filter_map(|(tick, role)| Some((tick?, role))).min()
    }
}

impl Default for Inputs {
    fn default() -> Self {
        Self::new()
    }
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

fn lacks<C: Topic>(of_tick: u64, tick: u64) -> Failure {
    gap(&format!("at tick {tick} the `{}` of tick {of_tick} was used, which is not in it", C::NAME))
}
