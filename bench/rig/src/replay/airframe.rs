//! Replays the plant: it takes the recorded commands at the ticks at which it took them.
//!
//! A recorded state says how many commands the plant had taken, and which was the last. The replay offers those that
//! are new since the state before. Each acts from the tick that its send stamp allows, as in the plant's process.
//! Skipped ticks are therefore flown with the commands that were in force in them.

use std::collections::VecDeque;

use model::envelope::Message;
use model::fault::gate::Gate;
use model::fault::{MessageFaults, Port};
use model::grid::Pace;
use model::layout::Walk as _;
use model::messages::{Change, Dated, NO_TICK, RotorSpeeds, State, SwapRecord};
use model::role::Role;
use plant::desk::swap_record;
use plant::latch::pending_commands;
use plant::{Plant, Swap, Target};

use crate::replay::compare::ReplayComparison;
use crate::replay::inputs::up_to;
use crate::window::Window;
use failure::Failure;

/// The plant, standing between two recorded states.
#[derive(Clone, Debug)]
pub struct AirframeReplay {
    plant: Plant,
    pace: Pace,
    /// Swaps that are known and still to come.
    swaps: VecDeque<Message<SwapRecord>>,
    /// Swaps that are known, or were.
    swaps_known: u64,
    /// Commands that the plant had taken with the state before.
    commands_taken: u64,
    /// Tick of the last of them.
    command_taken_tick: u64,
    /// Commands that can wait for the plant.
    room: u64,
}

impl AirframeReplay {
    /// The plant at tick 0.
    #[must_use]
    pub fn new(settings: &plant::PlantSettings, pace: Pace, faults: &MessageFaults) -> Self {
        let mut plant = Plant::new(settings);
        plant.gate(Gate::new(faults, Port::PlantRotorSpeeds));
        let room = pending_commands(settings.period_s) as u64;
        let swaps = VecDeque::new();
        Self { plant, pace, swaps, swaps_known: 0, commands_taken: 0, command_taken_tick: NO_TICK, room }
    }

    /// Takes the record of the next swap.
    pub fn push_swap(&mut self, swap: &Message<SwapRecord>) {
        self.swaps.push_back(*swap);
        self.swaps_known += 1;
    }

    /// Whether a state says of no other swaps than those whose records have come.
    #[must_use]
    pub const fn knows_swaps_of(&self, state: &State) -> bool {
        state.parameter_epoch <= self.swaps_known
    }

    /// Flies to a recorded state and compares it, and the swaps that took hold on the way.
    ///
    /// # Errors
    /// [`Failure`] where the log lacks what the state goes back to.
    pub fn step(
        &mut self,
        message: &Message<State>,
        commands: &Window<RotorSpeeds>,
        comparison: &mut ReplayComparison,
    ) -> Result<State, Failure> {
        let (tick, recorded) = (message.envelope.tick, &message.content);
        let due = self.schedule_until(tick)?;
        let new = recorded.commands_taken.wrapping_sub(self.commands_taken);
        let taken = up_to(commands, recorded.command_taken_tick, new, tick)?;
        let replayed = match self.begun_after_overflow(message, commands, new) {
            Some((plant, state)) => {
                self.plant = plant;
                state
            }
            None => begun(&mut self.plant, self.pace, taken, tick),
        };
        self.commands_taken = recorded.commands_taken;
        self.command_taken_tick = recorded.command_taken_tick;
        comparison.compare(tick, recorded, &replayed);
        let mut applied = self.plant.applied().iter().map(swap_record);
        for swap in due {
            let replayed = applied.next().unwrap_or_default();
            comparison.compare(swap.envelope.tick, &swap.content, &replayed);
        }
        self.plant.finish();
        Ok(replayed)
    }

    /// The plant at a tick before which it had looked for commands twice and stood still in between, so that its port
    /// overflowed: it took what lay there at first, and later the newest that had room, and what came while it took
    /// them. How many it took at first is not in the record: it is whatever leads to the state that is. None where
    /// nothing does: then the port overflowed before the first look, or not at all.
    fn begun_after_overflow(
        &self,
        message: &Message<State>,
        commands: &Window<RotorSpeeds>,
        new: u64,
    ) -> Option<(Plant, State)> {
        let (tick, recorded) = (message.envelope.tick, &message.content);
        (1..=new.saturating_sub(self.room)).rev().find_map(|first| {
            let taken = commands.parted(self.command_taken_tick, first, recorded.command_taken_tick, new - first)?;
            let mut plant = self.plant.clone();
            let state = begun(&mut plant, self.pace, taken, tick);
            state.is_same(recorded).then_some((plant, state))
        })
    }

    /// Hands the swaps of ticks up to this one to the plant, and gives them.
    fn schedule_until(&mut self, tick: u64) -> Result<Vec<Message<SwapRecord>>, Failure> {
        let mut due = Vec::new();
        while let Some(swap) = self.swaps.pop_front_if(|swap| swap.envelope.tick <= tick) {
            let target = |Change { parameter, new, steps, .. }| Target { parameter, value: new, steps };
            let targets: Vec<Target> = swap.content.changes().map(target).collect();
            let refused = |e: &dyn std::fmt::Display| {
                Failure::failed(format!("swap {} of the log cannot be applied: {e}", swap.content.parameter_epoch))
            };
            let order = Swap::to(swap.envelope.tick, &targets).map_err(|e| refused(&e))?;
            let held_from = self.plant.schedule(order).map_err(|e| refused(&e))?;
            if held_from != swap.envelope.tick {
                return Err(refused(&format!("it held from tick {}, which is past", swap.envelope.tick)));
            }
            due.push(swap);
        }
        Ok(due)
    }
}

/// The state of a tick, after commands were offered as the plant's process offers them.
fn begun<'a>(
    plant: &mut Plant,
    pace: Pace,
    commands: impl Iterator<Item = &'a Message<RotorSpeeds>>,
    tick: u64,
) -> State {
    for Message { envelope, content } in commands {
        let acts_from = pace.effective_tick(envelope.tick, envelope.stamps_of(Role::Mixer).send_ns);
        plant.offer(&Dated { tick: envelope.tick, content: *content }, acts_from);
    }
    plant.begin(tick)
}

#[cfg(test)]
mod tests {
    use model::envelope::Envelope;
    use model::telemetry::Signals;
    use plant::PlantSettings;

    use super::*;

    const TICK: u64 = 91;

    fn command(tick: u64) -> Message<RotorSpeeds> {
        let speed_rad_s = [200.0 + tick as f64 * 0.1; 4];
        let content = RotorSpeeds { speed_rad_s, ..RotorSpeeds::default() };
        Message { envelope: Envelope { tick, ..Envelope::new() }, content }
    }

    /// States of tick 1 and of tick 91, before which a plant took the first commands behind that of tick 0, and the
    /// last ones.
    fn flown(first: u64, last: u64) -> [Message<State>; 2] {
        let mut plant = Plant::new(&PlantSettings::default());
        plant.begin(0);
        plant.finish();
        let mut state = |tick, commands: Vec<u64>| {
            let commands: Vec<_> = commands.into_iter().map(command).collect();
            let content = begun(&mut plant, Pace::Lockstep, commands.iter(), tick);
            plant.finish();
            Message { envelope: Envelope { tick, ..Envelope::new() }, content }
        };
        [state(1, vec![0]), state(TICK, (1..=first).chain(TICK - last..TICK).collect())]
    }

    #[test]
    fn whatever_a_plant_took_before_its_port_overflowed_is_found() {
        let (settings, none) = (PlantSettings::default(), MessageFaults::none(0));
        let room = pending_commands(settings.period_s) as u64;
        for (first, more) in [(0, 0), (1, 0), (1, 1), (2, 0), (1, 5), (9, 2), (0, 3)] {
            let mut airframe = AirframeReplay::new(&settings, Pace::Lockstep, &none);
            let (mut commands, mut comparison) =
                (Window::keeping(TICK as usize), ReplayComparison::from(0, Signals::default()));
            commands.extend(&(0..TICK).map(command).collect::<Vec<_>>());
            let mut plant = Plant::new(&settings);
            let zero = Message { envelope: Envelope { tick: 0, ..Envelope::new() }, content: plant.begin(0) };
            let [one, late] = flown(first, room + more);
            for state in [zero, one, late] {
                let replayed = airframe.step(&state, &commands, &mut comparison).unwrap();
                assert!(replayed.is_same(&state.content), "tick {}, {first} and {more}", state.envelope.tick);
            }
        }
        let [early, late] = [flown(1, room + 1), flown(2, room)].map(|[_, late]| late.content);
        assert!(early.commands_taken == late.commands_taken && !early.is_same(&late), "the record alone does not say");
    }
}
