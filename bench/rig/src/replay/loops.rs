//! Replays the stages after the plant, and the monitor beside them: each on the inputs that its messages name.

use controller::{InnerLoop, OuterLoop};
use law::{InnerLaw as _, MixerLaw as _, OuterLaw as _};
use mixer::Mixer;
use model::envelope::Message;
use model::messages::{RotorSpeeds, Setpoint, Wrench};
use model::monitor::Monitor;

use crate::replay::compare::ReplayComparison;
use crate::replay::inputs::{Inputs, input, of};
use crate::settings::Settings;
use crate::theorem::FlightMonitor;
use failure::Failure;
use report::tally::is_last_word;

/// Outer loop, inner loop and mixer, and the theorem's monitor.
#[derive(Clone, Debug)]
pub struct LoopsReplay {
    controller: controller::LoopSettings,
    outer: OuterLoop,
    /// The inner loop, and the epoch of the process that it replays.
    inner: Option<(u64, InnerLoop)>,
    mixer: Mixer,
    theorem: FlightMonitor,
    /// Processes of the inner loop that were started in flight.
    pub restarts: u64,
}

impl LoopsReplay {
    /// The laws as they are started.
    ///
    /// # Errors
    /// A usage [`Failure`] names the parameter that cannot be, which flown settings rule out.
    pub fn new(settings: &Settings) -> Result<Self, Failure> {
        let controller = settings.controller()?;
        let (outer, mixer) = (OuterLoop::new(&controller), Mixer::new(&settings.mixer()?));
        let theorem = FlightMonitor::new(&controller);
        Ok(Self { controller, outer, inner: None, mixer, theorem, restarts: 0 })
    }

    /// Computes a recorded set-point again.
    ///
    /// # Errors
    /// [`Failure`] where its input is not in the log.
    pub fn setpoint(
        &mut self,
        message: &Message<Setpoint>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<Option<Setpoint>, Failure> {
        let tick = message.envelope.tick;
        let state = input(&inputs.states, message.envelope.input_tick[0], tick)?;
        let replayed = self.outer.tick(tick, &state);
        match &replayed {
            Some(setpoint) => comparison.compare(tick, &message.content, setpoint),
            None => comparison.differ::<Setpoint>(tick, "thrust_n".into(), "published".into(), "nothing".into()),
        }
        Ok(replayed)
    }

    /// Computes a recorded wrench again.
    ///
    /// # Errors
    /// [`Failure`] where an input is not in the log.
    pub fn wrench(
        &mut self,
        message: &Message<Wrench>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<Wrench, Failure> {
        let envelope = &message.envelope;
        let state = input(&inputs.states, envelope.input_tick[0], envelope.tick)?;
        let setpoint = input(&inputs.setpoints, envelope.input_tick[1], envelope.tick)?;
        let (epoch, mut law) = match self.inner.take() {
            Some((epoch, law)) if epoch == envelope.epoch => (epoch, law),
            other => {
                // Another process: it began with its priors.
                self.restarts += u64::from(other.is_some());
                (envelope.epoch, InnerLoop::new(&self.controller))
            }
        };
        let replayed = law.tick(envelope.tick, &state, &setpoint);
        self.inner = Some((epoch, law));
        comparison.compare(envelope.tick, &message.content, &replayed);
        Ok(replayed)
    }

    /// Computes a recorded rotor command again.
    ///
    /// # Errors
    /// [`Failure`] where its input is not in the log.
    pub fn rotor_speeds(
        &mut self,
        message: &Message<RotorSpeeds>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<RotorSpeeds, Failure> {
        let tick = message.envelope.tick;
        let replayed = if is_last_word(message) {
            self.mixer.idle()
        } else {
            self.mixer.tick(tick, &input(&inputs.wrenches, message.envelope.input_tick[2], tick)?)
        };
        comparison.compare(tick, &message.content, &replayed);
        Ok(replayed)
    }

    /// Says again what was said of the theorem, from the recorded wrench and its state.
    ///
    /// # Errors
    /// [`Failure`] where one of the two is not in the log.
    pub fn theorem(
        &mut self,
        message: &Message<Monitor>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        let tick = message.envelope.tick;
        let wrench = of(&inputs.wrenches, tick)?;
        let state = input(&inputs.states, wrench.envelope.input_tick[0], tick)?;
        match self.theorem.watch(wrench, Some(&state)) {
            Some(replayed) => comparison.compare(tick, &message.content, &replayed.content),
            None => comparison.differ::<Monitor>(tick, "ticks_checked".into(), "published".into(), "nothing".into()),
        }
        Ok(())
    }
}
