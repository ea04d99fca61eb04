//! Replays outer loop, inner loop, mixer and the theorem's monitor, each on the inputs that its messages name.

use control_api::{GuardedInner, GuardedMixer, GuardedOuter};
use faults::Port;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;

use crate::comparison::ReplayComparison;
use crate::inputs::{Inputs, RecordedInput, input, of};
use analysis::flight_statistics::is_final_command;
use config::Settings;
use controller::flight_monitor::FlightMonitor;
use errors::Failure;

/// Outer loop, inner loop and mixer, and the theorem's monitor.
pub struct LoopsReplay {
    settings: Settings,
    /// The outer loop with the epoch of the process it replays; likewise below.
    outer: Option<(u64, GuardedOuter)>,
    inner: Option<(u64, GuardedInner)>,
    mixer: Option<(u64, GuardedMixer)>,
    outer_state: RecordedInput<State>,
    inner_state: RecordedInput<State>,
    inner_setpoint: RecordedInput<Setpoint>,
    mixer_wrench: RecordedInput<Wrench>,
    theorem: FlightMonitor,
    /// Restarts of the inner loop in flight.
    pub restarts: u64,
    /// Estimates after the last two messages of the inner loop, the newest first.
    estimates: [Option<[f64; 3]>; 2],
}

impl LoopsReplay {
    /// The laws as they are started.
    pub fn new(settings: &Settings) -> Result<Self, Failure> {
        // A law that cannot be created is refused here rather than during the replay.
        settings.outer_stage()?;
        settings.inner_stage()?;
        settings.mixer_stage()?;
        let faults = settings.planned()?.loops.messages;
        Ok(Self {
            settings: settings.clone(),
            outer: None,
            inner: None,
            mixer: None,
            outer_state: RecordedInput::new(&faults, Port::OuterState),
            inner_state: RecordedInput::new(&faults, Port::InnerState),
            inner_setpoint: RecordedInput::new(&faults, Port::InnerSetpoint),
            mixer_wrench: RecordedInput::new(&faults, Port::MixerWrench),
            theorem: FlightMonitor::new(settings.theorem()?),
            restarts: 0,
            estimates: [None; 2],
        })
    }

    /// Takes the next recorded state; call it before any output that used the state.
    pub fn take_state(&mut self, message: &Message<State>) {
        self.outer_state.take(message);
        self.inner_state.take(message);
    }

    pub fn take_setpoint(&mut self, message: &Message<Setpoint>) {
        self.inner_setpoint.take(message);
    }

    pub fn take_wrench(&mut self, message: &Message<Wrench>) {
        self.mixer_wrench.take(message);
    }

    pub fn setpoint(
        &mut self,
        message: &Message<Setpoint>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<Option<Setpoint>, Failure> {
        let tick = message.envelope.tick;
        let state = self
            .outer_state
            .input(&inputs.states, message.envelope.input_tick[0], tick)?;
        let outer = of_epoch(&mut self.outer, message.envelope.epoch, &mut 0, || {
            self.settings.outer_stage()
        })?;
        let replayed = outer.tick(tick, &state);
        match &replayed {
            Some(setpoint) => comparison.compare(tick, &message.content, setpoint),
            None => comparison.lacks::<Setpoint>(tick, "thrust_n"),
        }
        Ok(replayed)
    }

    pub fn wrench(
        &mut self,
        message: &Message<Wrench>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<Wrench, Failure> {
        let envelope = &message.envelope;
        let state =
            self.inner_state
                .input(&inputs.states, envelope.input_tick[0], envelope.tick)?;
        let setpoint =
            self.inner_setpoint
                .input(&inputs.setpoints, envelope.input_tick[1], envelope.tick)?;
        let estimates = self.estimates;
        let inner = of_epoch(&mut self.inner, envelope.epoch, &mut self.restarts, || {
            resumed(&self.settings, estimates, message, &state, &setpoint)
        })?;
        let replayed = inner.tick(envelope.tick, &state, &setpoint);
        self.estimates = [inner.estimates(), estimates[0]];
        comparison.compare(envelope.tick, &message.content, &replayed);
        Ok(replayed)
    }

    pub fn rotor_speeds(
        &mut self,
        message: &Message<RotorSpeeds>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<RotorSpeeds, Failure> {
        let tick = message.envelope.tick;
        let mixer = of_epoch(&mut self.mixer, message.envelope.epoch, &mut 0, || {
            self.settings.mixer_stage()
        })?;
        let replayed = if is_final_command(message) {
            mixer.idle()
        } else {
            let wrench =
                self.mixer_wrench
                    .input(&inputs.wrenches, message.envelope.input_tick[2], tick)?;
            mixer.tick(tick, &wrench)
        };
        comparison.compare(tick, &message.content, &replayed);
        Ok(replayed)
    }

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
            None => comparison.lacks::<Monitor>(tick, "ticks_checked"),
        }
        Ok(())
    }
}

/// The inner loop of a process whose first message is `first`: with initial estimates, or with its predecessor's. A process
/// killed between sending a message and storing its estimates leaves the ones before.
fn resumed(
    settings: &Settings,
    estimates: [Option<[f64; 3]>; 2],
    first: &Message<Wrench>,
    state: &Stamped<State>,
    setpoint: &Stamped<Setpoint>,
) -> Result<GuardedInner, Failure> {
    let bits = |wrench: &Wrench| wrench.telemetry.value.map(f64::to_bits);
    let may_resume = settings.flight.resume_estimates;
    for estimates in estimates.into_iter().flatten().filter(|_| may_resume) {
        let mut inner = settings.inner_stage()?;
        let is_it = |wrench: Wrench| bits(&wrench) == bits(&first.content);
        if inner.resume(estimates)
            && inner
                .rehearse(first.envelope.tick, state, setpoint)
                .is_some_and(is_it)
        {
            return Ok(inner);
        }
    }
    settings.inner_stage()
}

/// The stage of the process with this epoch; a new epoch gets a new stage.
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
