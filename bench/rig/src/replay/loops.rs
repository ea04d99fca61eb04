//! Replays the stages after the plant: each law on the inputs that its messages name.

use controller::{OuterLoop, WatchedLoop};
use law::{InnerLaw as _, MixerLaw as _, OuterLaw as _};
use mixer::Mixer;
use model::envelope::Message;
use model::messages::{RotorSpeeds, Setpoint, State, Wrench};

use crate::replay::compare::ReplayComparison;
use crate::replay::window::Window;
use crate::settings::Settings;
use failure::Failure;
use report::tally::is_last_word;

/// Outer loop, inner loop and mixer.
#[derive(Clone, Debug)]
pub struct LoopsReplay {
    controller: controller::LoopSettings,
    outer: OuterLoop,
    /// The inner loop, and the epoch of the process that it replays.
    inner: Option<(u64, WatchedLoop)>,
    mixer: Mixer,
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
        Ok(Self { controller, outer, inner: None, mixer, restarts: 0 })
    }

    /// Computes a recorded set-point again.
    ///
    /// # Errors
    /// [`Failure`] where its input is not in the log.
    pub fn setpoint(
        &mut self,
        message: &Message<Setpoint>,
        states: &Window<State>,
        comparison: &mut ReplayComparison,
    ) -> Result<Option<Setpoint>, Failure> {
        let tick = message.envelope.tick;
        let state = states.input(message.envelope.input_tick[0], tick)?;
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
        states: &Window<State>,
        setpoints: &Window<Setpoint>,
        comparison: &mut ReplayComparison,
    ) -> Result<Wrench, Failure> {
        let envelope = &message.envelope;
        let state = states.input(envelope.input_tick[0], envelope.tick)?;
        let setpoint = setpoints.input(envelope.input_tick[1], envelope.tick)?;
        let (epoch, mut law) = match self.inner.take() {
            Some((epoch, law)) if epoch == envelope.epoch => (epoch, law),
            other => {
                // Another process: it began with its priors.
                self.restarts += u64::from(other.is_some());
                (envelope.epoch, WatchedLoop::new(&self.controller))
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
        wrenches: &Window<Wrench>,
        comparison: &mut ReplayComparison,
    ) -> Result<RotorSpeeds, Failure> {
        let tick = message.envelope.tick;
        let replayed = if is_last_word(message) {
            self.mixer.idle()
        } else {
            self.mixer.tick(tick, &wrenches.input(message.envelope.input_tick[2], tick)?)
        };
        comparison.compare(tick, &message.content, &replayed);
        Ok(replayed)
    }
}
