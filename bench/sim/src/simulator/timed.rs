//! A simulated flight with the timing of a recorded one ([`crate::recorded_timing`]).

use std::collections::VecDeque;

use ipc::DEEP;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::Message;
use messages::output_hash::OutputHash;
use messages::topic::Topic;

use crate::recorded_timing::{Event, Source};
use crate::simulator::Simulator;
use config::Settings;
use control_api::SavedState;
use errors::Failure;
use messages::message_window::MessageWindow;
use plant::EnvelopeViolation;

/// Outputs of the stages so far, and the epochs of their processes.
#[derive(Debug)]
pub struct Timed {
    states: MessageWindow<State>,
    setpoints: MessageWindow<Setpoint>,
    wrenches: MessageWindow<Wrench>,
    /// Each with the first tick in which it may act.
    commands: VecDeque<(Stamped<RotorSpeeds>, u64)>,
    taken: u64,
    /// Epochs of the current outer loop, inner loop and mixer.
    epochs: [Option<u64>; 3],
    saved: SavedState,
}

impl Timed {
    pub(crate) fn new() -> Self {
        Self {
            states: MessageWindow::keeping(DEEP),
            setpoints: MessageWindow::keeping(DEEP),
            wrenches: MessageWindow::keeping(DEEP),
            commands: VecDeque::new(),
            taken: 0,
            epochs: [None; 3],
            saved: SavedState::new(),
        }
    }

    /// Repeats the computation of one recorded message and adds its output to `outputs`, except a state, which the caller
    /// has to check first. There is no output if this flight has no such input.
    pub fn play(
        &mut self,
        event: &Event,
        rig: &mut Simulator,
        settings: &Settings,
        outputs: &mut OutputHash,
    ) -> Result<(), Failure> {
        let tick = event.tick;
        match event.source {
            Source::State { taken, taken_tick } => {
                self.offer(taken, taken_tick, rig);
                rig.plant.begin_into(tick, &mut rig.state.content);
                (rig.state.tick, rig.tick) = (tick, tick + 1);
                rig.envelope = rig.plant.envelope();
                if !matches!(rig.envelope, Err(EnvelopeViolation::NotFinite { .. })) {
                    put(&mut self.states, tick, &rig.state.content);
                }
                rig.plant.finish();
            }
            Source::Setpoint { state } => {
                if begins(&mut self.epochs[0], event.epoch) {
                    rig.outer
                        .replace_by(settings.outer_stage()?, &mut self.saved);
                }
                let state = self.states.input(state);
                if state.is_some_and(|state| {
                    rig.outer.tick_into(tick, &state, &mut rig.setpoint.content)
                }) {
                    rig.setpoint.tick = tick;
                    put(&mut self.setpoints, tick, &rig.setpoint.content);
                    outputs.take(tick, &rig.setpoint.content);
                }
            }
            Source::Wrench { state, setpoint } => {
                if begins(&mut self.epochs[1], event.epoch) {
                    rig.inner
                        .replace_by(settings.inner_stage()?, &mut self.saved);
                    rig.theorem.begin(rig.theorem.epoch() + 1);
                }
                if let (Some(state), Some(setpoint)) =
                    (self.states.input(state), self.setpoints.input(setpoint))
                {
                    rig.inner
                        .tick_into(tick, &state, &setpoint, &mut rig.wrench.content);
                    rig.wrench.tick = tick;
                    put(&mut self.wrenches, tick, &rig.wrench.content);
                    outputs.take(tick, &rig.wrench.content);
                    rig.watch(&state);
                }
            }
            Source::RotorSpeeds { wrench, acts_from } => {
                if begins(&mut self.epochs[2], event.epoch) {
                    rig.mixer
                        .replace_by(settings.mixer_stage()?, &mut self.saved);
                }
                if let Some(wrench) = self.wrenches.input(wrench) {
                    rig.mixer
                        .tick_into(tick, &wrench, &mut rig.rotor_speeds.content);
                    rig.rotor_speeds.tick = tick;
                    self.commands.push_back((rig.rotor_speeds, acts_from));
                    outputs.take(tick, &rig.rotor_speeds.content);
                }
            }
        }
        Ok(())
    }

    /// Offers the commands that the plant took before a state; older ones were lost.
    fn offer(&mut self, taken: u64, taken_tick: u64, rig: &mut Simulator) {
        let new = taken.saturating_sub(self.taken);
        self.taken = taken;
        let until = self
            .commands
            .iter()
            .take_while(|(command, _)| new > 0 && command.tick <= taken_tick)
            .count();
        let lost = until.saturating_sub(usize::try_from(new).unwrap_or(usize::MAX));
        for (command, acts_from) in self.commands.drain(..until).skip(lost) {
            rig.plant.offer(&command, acts_from);
        }
    }
}

fn begins(epoch: &mut Option<u64>, now: u64) -> bool {
    epoch.replace(now).is_some_and(|before| before != now)
}

fn put<C: Topic>(window: &mut MessageWindow<C>, tick: u64, content: &C) {
    window.push(Message::of_tick(tick, *content));
    window.advance();
}
