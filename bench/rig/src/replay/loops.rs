//! Replays the stages after the plant, and the monitor beside them: each on the inputs that its messages name.

use law::stage::{InnerStage as _, MixerStage as _, OuterStage as _};
use law::{GuardedInner, GuardedMixer, GuardedOuter};
use model::envelope::Message;
use model::fault::Port;
use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;

use crate::replay::compare::ReplayComparison;
use crate::replay::inputs::{Inputs, input, of};
use crate::replay::struck::Struck;
use crate::settings::Settings;
use crate::theorem::FlightMonitor;
use failure::Failure;
use report::tally::is_last_word;

/// Outer loop, inner loop and mixer, and the theorem's monitor.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct LoopsReplay {
    settings: Settings,
    /// The outer loop, and the epoch of the process that it replays.
    outer: Option<(u64, GuardedOuter)>,
    /// The inner loop, and the epoch of the process that it replays.
    inner: Option<(u64, GuardedInner)>,
    /// The mixer, and the epoch of the process that it replays.
    mixer: Option<(u64, GuardedMixer)>,
    outer_state: Struck<State>,
    inner_state: Struck<State>,
    inner_setpoint: Struck<Setpoint>,
    mixer_wrench: Struck<Wrench>,
    theorem: FlightMonitor,
    /// Processes of the inner loop that were started in flight.
    pub restarts: u64,
    /// What the inner loop had learnt with its last two messages, the last one first.
    learnt: [Option<[f64; 3]>; 2],
}

impl LoopsReplay {
    /// The laws as they are started.
    ///
    /// # Errors
    /// A usage [`Failure`] names the parameter that cannot be, which flown settings rule out.
    pub fn new(settings: &Settings) -> Result<Self, Failure> {
        // What cannot be started is refused here, and not in the middle of a flight.
        settings.outer_stage()?;
        settings.inner_stage()?;
        settings.mixer_stage()?;
        let faults = settings.planned()?.loops.messages;
        Ok(Self {
            settings: settings.clone(),
            outer: None,
            inner: None,
            mixer: None,
            outer_state: Struck::new(&faults, Port::OuterState),
            inner_state: Struck::new(&faults, Port::InnerState),
            inner_setpoint: Struck::new(&faults, Port::InnerSetpoint),
            mixer_wrench: Struck::new(&faults, Port::MixerWrench),
            theorem: FlightMonitor::new(settings.theorem()?),
            restarts: 0,
            learnt: [None; 2],
        })
    }

    /// Takes the next recorded state, before whatever was made from it.
    pub fn take_state(&mut self, message: &Message<State>) {
        self.outer_state.take(message);
        self.inner_state.take(message);
    }

    /// Takes the next recorded set-point, before whatever was made from it.
    pub fn take_setpoint(&mut self, message: &Message<Setpoint>) {
        self.inner_setpoint.take(message);
    }

    /// Takes the next recorded wrench, before whatever was made from it.
    pub fn take_wrench(&mut self, message: &Message<Wrench>) {
        self.mixer_wrench.take(message);
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
        let state = self.outer_state.input(&inputs.states, message.envelope.input_tick[0], tick)?;
        let outer = of_epoch(&mut self.outer, message.envelope.epoch, &mut 0, || self.settings.outer_stage())?;
        let replayed = outer.tick(tick, &state);
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
        let state = self.inner_state.input(&inputs.states, envelope.input_tick[0], envelope.tick)?;
        let setpoint = self.inner_setpoint.input(&inputs.setpoints, envelope.input_tick[1], envelope.tick)?;
        let learnt = self.learnt;
        let inner = of_epoch(&mut self.inner, envelope.epoch, &mut self.restarts, || {
            resumed(&self.settings, learnt, message, &state, &setpoint)
        })?;
        let replayed = inner.tick(envelope.tick, &state, &setpoint);
        self.learnt = [inner.estimates(), learnt[0]];
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
        let mixer = of_epoch(&mut self.mixer, message.envelope.epoch, &mut 0, || self.settings.mixer_stage())?;
        let replayed = if is_last_word(message) {
            mixer.idle()
        } else {
            let wrench = self.mixer_wrench.input(&inputs.wrenches, message.envelope.input_tick[2], tick)?;
            mixer.tick(tick, &wrench)
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

/// The inner loop of a process that sent this as its first message: with its priors, or with what its predecessor had
/// learnt. A process that is killed between sending and writing it down leaves what it had learnt before.
fn resumed(
    settings: &Settings,
    learnt: [Option<[f64; 3]>; 2],
    first: &Message<Wrench>,
    state: &Dated<State>,
    setpoint: &Dated<Setpoint>,
) -> Result<GuardedInner, Failure> {
    let bits = |wrench: &Wrench| wrench.telemetry.value.map(f64::to_bits);
    for estimates in learnt.into_iter().flatten().filter(|_| settings.flight.resume_estimates) {
        let mut inner = settings.inner_stage()?;
        let is_it = |wrench: Wrench| bits(&wrench) == bits(&first.content);
        if inner.resume(estimates) && inner.rehearse(first.envelope.tick, state, setpoint).is_some_and(is_it) {
            return Ok(inner);
        }
    }
    settings.inner_stage()
}

/// The stage of a process: where another one sent the message, that one began anew.
fn of_epoch<'a, S>(
    stage: &'a mut Option<(u64, S)>,
    epoch: u64,
    restarts: &mut u64,
    start: impl FnOnce() -> Result<S, Failure>,
) -> Result<&'a mut S, Failure> {
    if stage.as_ref().is_none_or(|(of, _)| *of != epoch) {
        *restarts += u64::from(stage.is_some());
        *stage = None;
    }
    match stage {
        Some((_, stage)) => Ok(stage),
        none => Ok(&mut none.insert((epoch, start()?)).1),
    }
}
