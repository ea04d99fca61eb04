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
use model::messages::{Change, Dated, RotorSpeeds, State, SwapRecord};
use model::role::Role;
use plant::desk::swap_record;
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
}

impl AirframeReplay {
    /// The plant at tick 0.
    #[must_use]
    pub fn new(settings: &plant::PlantSettings, pace: Pace, faults: &MessageFaults) -> Self {
        let mut plant = Plant::new(settings);
        plant.gate(Gate::new(faults, Port::PlantRotorSpeeds));
        Self { plant, pace, swaps: VecDeque::new(), swaps_known: 0, commands_taken: 0 }
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
        for command in up_to(
            commands,
            recorded.command_taken_tick,
            recorded.commands_taken.wrapping_sub(self.commands_taken),
            tick,
        )? {
            let envelope = &command.envelope;
            let acts_from = self.pace.effective_tick(envelope.tick, envelope.stamps_of(Role::Mixer).send_ns);
            self.plant.offer(&Dated { tick: envelope.tick, content: command.content }, acts_from);
        }
        self.commands_taken = recorded.commands_taken;
        let replayed = self.plant.begin(tick);
        comparison.compare(tick, recorded, &replayed);
        let mut applied = self.plant.applied().iter().map(swap_record);
        for swap in due {
            let replayed = applied.next().unwrap_or_default();
            comparison.compare(swap.envelope.tick, &swap.content, &replayed);
        }
        self.plant.finish();
        Ok(replayed)
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
