//! Replays the plant with the recorded commands, each taken at the tick at which the flight took it.
//!
//! A recorded state holds how many commands the plant had taken, and the tick of the last one. The replay offers those that
//! are new since the previous state. Each acts from the tick that its send stamp allows, as in the plant's process, so
//! skipped ticks are integrated with the commands that were active then.

use std::collections::VecDeque;

use faults::filter::FaultFilter;
use faults::{MessageFaults, Port};
use messages::content::{Change, NO_TICK, RotorSpeeds, Stamped, State, SwapRecord};
use messages::grid::Pace;
use messages::header::Message;
use messages::layout::Visit as _;
use messages::role::Role;
use plant::command_hold::pending_commands;
use plant::{Plant, Swap, Target};

use crate::comparison::ReplayComparison;
use crate::inputs::up_to;
use errors::Failure;
use messages::message_window::MessageWindow;

/// The plant between two recorded states.
#[derive(Clone, Debug)]
pub struct AirframeReplay {
    plant: Box<Plant>,
    pace: Pace,
    /// Swaps that were read and are not applied yet.
    swaps: VecDeque<Message<SwapRecord>>,
    swaps_known: u64,
    /// Commands taken up to the previous state.
    commands_taken: u64,
    /// Tick of the last one.
    command_taken_tick: u64,
    /// Capacity of the plant's command port.
    room: u64,
}

impl AirframeReplay {
    pub fn new(settings: &plant::PlantSettings, pace: Pace, faults: &MessageFaults) -> Self {
        let mut plant = Box::new(Plant::new(settings));
        plant.set_fault_filter(FaultFilter::new(faults, Port::PlantRotorSpeeds));
        Self {
            plant,
            pace,
            swaps: VecDeque::new(),
            swaps_known: 0,
            commands_taken: 0,
            command_taken_tick: NO_TICK,
            room: pending_commands(settings.period_s) as u64,
        }
    }

    pub fn push_swap(&mut self, swap: &Message<SwapRecord>) {
        self.swaps.push_back(*swap);
        self.swaps_known += 1;
    }

    /// Whether the records of all swaps in this state have been read.
    pub const fn knows_swaps_of(&self, state: &State) -> bool {
        state.parameter_epoch <= self.swaps_known
    }

    /// Integrates to a recorded state, and compares it and the swaps applied on the way.
    pub fn step(
        &mut self,
        message: &Message<State>,
        commands: &MessageWindow<RotorSpeeds>,
        comparison: &mut ReplayComparison,
    ) -> Result<State, Failure> {
        let (tick, recorded) = (message.envelope.tick, &message.content);
        let due = self.schedule_until(tick)?;
        let new = recorded.commands_taken.wrapping_sub(self.commands_taken);
        let taken = up_to(commands, recorded.command_taken_tick, new, tick)?;
        let overflow = (new > self.room)
            .then(|| self.begun_after_overflow(message, commands, new))
            .flatten();
        let replayed = match overflow {
            Some((plant, state)) => {
                self.plant = plant;
                state
            }
            None => begun(&mut self.plant, self.pace, taken, tick),
        };
        self.commands_taken = recorded.commands_taken;
        self.command_taken_tick = recorded.command_taken_tick;
        comparison.compare(tick, recorded, &replayed);
        let mut applied = self.plant.applied().iter().map(plant::AppliedSwap::record);
        for swap in due {
            let replayed = applied.next().unwrap_or_default();
            comparison.compare(swap.envelope.tick, &swap.content, &replayed);
        }
        self.plant.finish();
        Ok(replayed)
    }

    /// The plant if its port overflowed because the process stood still between its two reads within a tick. It then took
    /// some commands at the first read, and at the second the newest ones that the port had kept. The record does not say
    /// how many it took first, so each number is tried until the recorded state results. None if no number does: the port
    /// overflowed before the first read, or not at all.
    #[cold]
    #[inline(never)]
    fn begun_after_overflow(
        &self,
        message: &Message<State>,
        commands: &MessageWindow<RotorSpeeds>,
        new: u64,
    ) -> Option<(Box<Plant>, State)> {
        let (tick, recorded) = (message.envelope.tick, &message.content);
        (1..=new.saturating_sub(self.room)).rev().find_map(|first| {
            let taken = commands.parted(
                self.command_taken_tick,
                first,
                recorded.command_taken_tick,
                new - first,
            )?;
            let mut plant = self.plant.clone();
            let state = begun(&mut plant, self.pace, taken, tick);
            state.is_same(recorded).then_some((plant, state))
        })
    }

    /// Schedules and returns the swaps up to this tick.
    fn schedule_until(&mut self, tick: u64) -> Result<Vec<Message<SwapRecord>>, Failure> {
        let mut due = Vec::new();
        while let Some(swap) = self.swaps.pop_front_if(|swap| swap.envelope.tick <= tick) {
            let target = |change: Change| Target {
                parameter: change.parameter,
                value: change.new,
                steps: change.steps,
            };
            let targets: Vec<Target> = swap.content.changes().map(target).collect();
            let refused = |e: &dyn std::fmt::Display| {
                let epoch = swap.content.parameter_epoch;
                Failure::failed(format!("swap {epoch} of the log cannot be applied: {e}"))
            };
            let order = Swap::to(swap.envelope.tick, &targets).map_err(|e| refused(&e))?;
            let held_from = self.plant.schedule(order).map_err(|e| refused(&e))?;
            if held_from != swap.envelope.tick {
                return Err(refused(&format!(
                    "it was applied at tick {}, which is past",
                    swap.envelope.tick
                )));
            }
            due.push(swap);
        }
        Ok(due)
    }
}

/// Offers the commands as the plant's process does, and begins the tick.
fn begun<'a>(
    plant: &mut Plant,
    pace: Pace,
    commands: impl Iterator<Item = &'a Message<RotorSpeeds>>,
    tick: u64,
) -> State {
    for Message { envelope, content } in commands {
        let acts_from = pace.effective_tick(envelope.tick, envelope.stamps_of(Role::Mixer).send_ns);
        plant.offer(&Stamped::new(envelope.tick, *content), acts_from);
    }
    plant.begin(tick)
}

#[cfg(test)]
mod tests {
    use messages::role::Channel;
    use messages::telemetry::Signals;
    use plant::PlantSettings;

    use super::*;

    const TICK: u64 = 91;

    fn command(tick: u64) -> Message<RotorSpeeds> {
        let content = RotorSpeeds {
            speed_rad_s: [200.0 + tick as f64 * 0.1; 4],
            ..RotorSpeeds::default()
        };
        Message::of_tick(tick, content)
    }

    /// States of the ticks 0, 1 and 91. Before the last one, the plant took the `first` commands behind that of tick 0,
    /// and the `last` ones.
    fn flown(first: u64, last: u64) -> [Message<State>; 3] {
        let mut plant = Plant::new(&PlantSettings::default());
        let mut state = |tick, commands: Vec<u64>| {
            let commands: Vec<_> = commands.into_iter().map(command).collect();
            let content = begun(&mut plant, Pace::Lockstep, commands.iter(), tick);
            plant.finish();
            Message::of_tick(tick, content)
        };
        let late = (1..=first).chain(TICK - last..TICK).collect();
        [state(0, vec![]), state(1, vec![0]), state(TICK, late)]
    }

    #[test]
    fn whatever_a_plant_took_before_its_port_overflowed_is_found() {
        let (settings, none) = (PlantSettings::default(), MessageFaults::none(0));
        let room = pending_commands(settings.period_s) as u64;
        let mut commands = MessageWindow::keeping(TICK as usize);
        (0..TICK).for_each(|tick| commands.push(command(tick)));
        for (first, more) in [(0, 0), (1, 0), (1, 1), (2, 0), (1, 5), (9, 2), (0, 3)] {
            let mut airframe = AirframeReplay::new(&settings, Pace::Lockstep, &none);
            let mut comparison = ReplayComparison::from(0, Channel::A, Signals::default());
            for state in flown(first, room + more) {
                let replayed = airframe.step(&state, &commands, &mut comparison).unwrap();
                let tick = state.envelope.tick;
                assert!(
                    replayed.is_same(&state.content),
                    "tick {tick}, {first} and {more}"
                );
            }
        }
        let [early, late] = [flown(1, room + 1), flown(2, room)].map(|[.., late]| late.content);
        assert!(
            early.commands_taken == late.commands_taken && !early.is_same(&late),
            "the record alone does not say"
        );
    }
}
