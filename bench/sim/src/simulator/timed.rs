//! A simulated flight with the timing of a recorded one ([`crate::recorded_timing`]).

use std::collections::VecDeque;

use ipc::DEEP;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::output_hash::OutputHash;

use crate::recorded_timing::{Event, Source};
use crate::simulator::Simulator;
use config::Settings;
use control_api::SavedState;
use errors::Failure;
use messages::header::Message;
use messages::message_window::MessageWindow;
use plant::EnvelopeViolation;

/// Outputs of the stages so far, and the epochs of their processes.
#[derive(Debug)]
pub struct Timed {
    states: MessageWindow<State>,
    setpoints: MessageWindow<Setpoint>,
    wrenches: MessageWindow<Wrench>,
    /// Inputs that the outer loop, the inner loop and the mixer used last.
    outer_used: Stamped<State>,
    inner_used: (Stamped<State>, Stamped<Setpoint>),
    mixer_used: Stamped<Wrench>,
    /// Each with the first tick in which it may act.
    commands: VecDeque<(Stamped<RotorSpeeds>, u64)>,
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
            outer_used: Stamped::never(),
            inner_used: (Stamped::never(), Stamped::never()),
            mixer_used: Stamped::never(),
            commands: VecDeque::new(),
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
            Source::Taken { command } => self.offer(command, rig),
            Source::State => {
                rig.plant.begin_into(tick, &mut rig.state.content);
                (rig.state.tick, rig.tick) = (tick, tick + 1);
                rig.envelope = rig.plant.envelope();
                if !matches!(rig.envelope, Err(EnvelopeViolation::NotFinite { .. })) {
                    self.states.push(&Message::of_tick(tick, rig.state.content));
                }
                rig.plant.finish();
            }
            Source::Setpoint { state } => {
                if begins(&mut self.epochs[0], event.epoch) {
                    rig.outer
                        .replace_by(settings.outer_stage()?, &mut self.saved);
                }
                let state = self.states.input_kept(state, &mut self.outer_used);
                if state.is_some_and(|state| {
                    rig.outer.tick_into(tick, state, &mut rig.setpoint.content)
                }) {
                    rig.setpoint.tick = tick;
                    self.setpoints
                        .push(&Message::of_tick(tick, rig.setpoint.content));
                    outputs.take(tick, &rig.setpoint.content);
                }
            }
            Source::Wrench { state, setpoint } => {
                if begins(&mut self.epochs[1], event.epoch)
                    && !rig
                        .inner
                        .replace_by(settings.inner_stage()?, &mut self.saved)
                {
                    rig.theorem.begin();
                }
                let used = &mut self.inner_used;
                if let (Some(state), Some(setpoint)) = (
                    self.states.input_kept(state, &mut used.0),
                    self.setpoints.input_kept(setpoint, &mut used.1),
                ) {
                    rig.inner
                        .tick_into(tick, state, setpoint, &mut rig.wrench.content);
                    rig.wrench.tick = tick;
                    self.wrenches
                        .push(&Message::of_tick(tick, rig.wrench.content));
                    outputs.take(tick, &rig.wrench.content);
                    rig.watch(state, setpoint);
                }
            }
            Source::RotorSpeeds { wrench, acts_from } => {
                if begins(&mut self.epochs[2], event.epoch) {
                    rig.mixer
                        .replace_by(settings.mixer_stage()?, &mut self.saved);
                }
                if let Some(wrench) = self.wrenches.input_kept(wrench, &mut self.mixer_used) {
                    rig.mixer
                        .tick_into(tick, wrench, &mut rig.rotor_speeds.content);
                    rig.rotor_speeds.tick = tick;
                    rig.theorem.command(tick, &rig.rotor_speeds.content);
                    self.commands.push_back((rig.rotor_speeds, acts_from));
                    outputs.take(tick, &rig.rotor_speeds.content);
                }
            }
        }
        Ok(())
    }

    /// Offers the command that the plant took for a tick; older ones were not taken.
    fn offer(&mut self, tick: u64, rig: &mut Simulator) {
        while let Some((command, acts_from)) = self.commands.pop_front_if(|it| it.0.tick <= tick) {
            if command.tick == tick {
                rig.plant.offer(&command, acts_from);
            }
        }
    }
}

fn begins(epoch: &mut Option<u64>, now: u64) -> bool {
    epoch.replace(now).is_some_and(|before| before != now)
}
