//! A flight in one process with the timing of a recorded one ([`crate::timing`]).

use std::collections::VecDeque;

use law::stage::{InnerStage as _, MixerStage as _, OuterStage as _};
use model::envelope::{Envelope, Message};
use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};
use model::output_hash::OutputHash;
use model::topic::Topic;
use wire::DEEP;

use crate::in_process::InProcess;
use crate::settings::Settings;
use crate::theorem::FlightMonitor;
use crate::timing::{Event, Made};
use crate::window::Window;
use failure::Failure;
use plant::Departure;

/// What the stages put out so far, and whose they are.
#[derive(Debug)]
pub struct Timed {
    states: Window<State>,
    setpoints: Window<Setpoint>,
    wrenches: Window<Wrench>,
    /// Each with the tick from which on it may act.
    commands: VecDeque<(Dated<RotorSpeeds>, u64)>,
    /// Commands that the plant has taken.
    taken: u64,
    /// Start of the outer loop, inner loop and mixer that work now.
    epochs: [Option<u64>; 3],
    /// Wrenches of the inner loop that works now.
    wrenches_of_epoch: u64,
    theorem: FlightMonitor,
}

impl Timed {
    /// Before the first message.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn new(settings: &Settings) -> Result<Self, Failure> {
        Ok(Self {
            states: Window::keeping(DEEP),
            setpoints: Window::keeping(DEEP),
            wrenches: Window::keeping(DEEP),
            commands: VecDeque::new(),
            taken: 0,
            epochs: [None; 3],
            wrenches_of_epoch: 0,
            theorem: FlightMonitor::new(settings.theorem()?),
        })
    }

    /// Does again what made a message of the recorded flight. What comes of it is taken into `outputs`, other than a
    /// state, which is still to be judged. Nothing comes where the flight is another one, and there is no such input.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn play(
        &mut self,
        event: &Event,
        rig: &mut InProcess,
        settings: &Settings,
        outputs: &mut OutputHash,
    ) -> Result<(), Failure> {
        let tick = event.tick;
        match event.made {
            Made::State { taken, taken_tick } => {
                self.offer(taken, taken_tick, rig);
                rig.plant.begin_into(tick, &mut rig.state.content);
                (rig.state.tick, rig.tick) = (tick, tick + 1);
                rig.envelope = rig.plant.envelope();
                if !matches!(rig.envelope, Err(Departure::NotFinite { .. })) {
                    put(&mut self.states, tick, &rig.state.content);
                }
                rig.plant.finish();
            }
            Made::Setpoint { state } => {
                if begins(&mut self.epochs[0], event.epoch) {
                    rig.outer = settings.outer_stage()?;
                }
                let state = self.states.input(state);
                if state.is_some_and(|state| rig.outer.tick_into(tick, &state, &mut rig.setpoint.content)) {
                    rig.setpoint.tick = tick;
                    put(&mut self.setpoints, tick, &rig.setpoint.content);
                    outputs.take(tick, &rig.setpoint.content);
                }
            }
            Made::Wrench { state, setpoint } => {
                if begins(&mut self.epochs[1], event.epoch) {
                    rig.inner = settings.inner_stage()?;
                    self.wrenches_of_epoch = 0;
                }
                if let (Some(state), Some(setpoint)) = (self.states.input(state), self.setpoints.input(setpoint)) {
                    rig.inner.tick_into(tick, &state, &setpoint, &mut rig.wrench.content);
                    rig.wrench.tick = tick;
                    put(&mut self.wrenches, tick, &rig.wrench.content);
                    outputs.take(tick, &rig.wrench.content);
                    self.watch(event, &state, rig);
                }
            }
            Made::RotorSpeeds { wrench, acts_from } => {
                if begins(&mut self.epochs[2], event.epoch) {
                    rig.mixer = settings.mixer_stage()?;
                }
                if let Some(wrench) = self.wrenches.input(wrench) {
                    rig.mixer.tick_into(tick, &wrench, &mut rig.rotor_speeds.content);
                    rig.rotor_speeds.tick = tick;
                    self.commands.push_back((rig.rotor_speeds, acts_from));
                    outputs.take(tick, &rig.rotor_speeds.content);
                }
            }
        }
        Ok(())
    }

    /// Offers the commands that the plant took before a state; older ones were lost on their way.
    fn offer(&mut self, taken: u64, taken_tick: u64, rig: &mut InProcess) {
        let new = taken.saturating_sub(self.taken);
        self.taken = taken;
        let until = self.commands.iter().take_while(|(command, _)| new > 0 && command.tick <= taken_tick).count();
        let lost = until.saturating_sub(usize::try_from(new).unwrap_or(usize::MAX));
        for (command, acts_from) in self.commands.drain(..until).skip(lost) {
            rig.plant.offer(&command, acts_from);
        }
    }

    fn watch(&mut self, event: &Event, state: &Dated<State>, rig: &mut InProcess) {
        let seq = self.wrenches_of_epoch;
        self.wrenches_of_epoch += 1;
        let envelope = Envelope { tick: event.tick, epoch: event.epoch, seq, ..Envelope::new() };
        let wrench = Message { envelope, content: rig.wrench.content };
        rig.monitor = self.theorem.watch(&wrench, Some(state)).map(|said| said.content);
    }
}

/// Whether another process begins.
fn begins(epoch: &mut Option<u64>, now: u64) -> bool {
    epoch.replace(now).is_some_and(|before| before != now)
}

fn put<C: Topic>(window: &mut Window<C>, tick: u64, content: &C) {
    window.extend(&[Message { envelope: Envelope { tick, ..Envelope::new() }, content: *content }]);
    window.advance();
}
