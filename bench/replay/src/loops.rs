//! Replays outer loop, inner loop, mixer and the theorem's monitor, each on the inputs that its messages name.

use std::ops::RangeInclusive;

use control_api::guard::Guarded;
use control_api::law::CopyState;
use control_api::saved_state::Field;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use faults::Port;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::{Header, Message};
use messages::layout::Visit as _;
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
    outer: Option<Replayed<GuardedOuter>>,
    inner: Option<Replayed<GuardedInner>>,
    mixer: Option<Replayed<GuardedMixer>>,
    outer_state: RecordedInput<State>,
    inner_state: RecordedInput<State>,
    inner_setpoint: RecordedInput<Setpoint>,
    mixer_wrench: RecordedInput<Wrench>,
    theorem: FlightMonitor,
    /// The inner loop's newest state, after the faults of its input.
    inner_input: Stamped<State>,
    pub restarts: u64,
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
            theorem: FlightMonitor::new(settings.theorem()?, settings.rt.channels),
            inner_input: Stamped::never(),
            restarts: 0,
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
        let is_it = |outer: &mut GuardedOuter| {
            let first = outer.tick(tick, &state);
            first.is_some_and(|it| it.is_same(&message.content))
        };
        let redo = |outer: &mut GuardedOuter, tick| {
            outer.tick(tick, &inputs.states.input(tick)?).map(drop)
        };
        let make = || self.settings.outer_stage();
        let sent = Sent::of(&message.envelope, 0..=0, self.settings.rt.channels);
        let outer = of_epoch(&mut self.outer, &sent, &mut 0, make, is_it, redo)?;
        let replayed = outer.work(&sent, |outer| outer.tick(tick, &state));
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
        self.inner_input = state;
        let setpoint =
            self.inner_setpoint
                .input(&inputs.setpoints, envelope.input_tick[1], envelope.tick)?;
        let is_it = |inner: &mut GuardedInner| {
            let first = inner.tick(envelope.tick, &state, &setpoint);
            first.is_same(&message.content)
        };
        let redo = |inner: &mut GuardedInner, tick| {
            let (state, setpoint) = (inputs.states.input(tick)?, inputs.setpoints.input(tick)?);
            inner.tick(tick, &state, &setpoint);
            Some(())
        };
        let make = || self.settings.inner_stage();
        let sent = Sent::of(envelope, 0..=1, self.settings.rt.channels);
        let mut handovers = 0;
        let (inner, restarts) = match self.settings.rt.channels {
            1 => (&mut self.inner, &mut self.restarts),
            _ => (&mut self.inner, &mut handovers),
        };
        let inner = of_epoch(inner, &sent, restarts, make, is_it, redo)?;
        let replayed = inner.work(&sent, |inner| inner.tick(envelope.tick, &state, &setpoint));
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
        let is_final = is_final_command(message);
        let wrench = if is_final {
            Stamped::never()
        } else {
            self.mixer_wrench
                .input(&inputs.wrenches, message.envelope.input_tick[2], tick)?
        };
        let is_it = |mixer: &mut GuardedMixer| {
            is_final || mixer.tick(tick, &wrench).is_same(&message.content)
        };
        let redo = |mixer: &mut GuardedMixer, tick| {
            mixer.tick(tick, &inputs.wrenches.input(tick)?);
            Some(())
        };
        let make = || self.settings.mixer_stage();
        let sent = Sent::of(&message.envelope, 2..=2, self.settings.rt.channels);
        let mixer = of_epoch(&mut self.mixer, &sent, &mut 0, make, is_it, redo)?;
        let replayed = mixer.work(&sent, |mixer| match is_final {
            true => mixer.idle(),
            false => mixer.tick(tick, &wrench),
        });
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
        let mut state = input(&inputs.states, wrench.envelope.input_tick[0], tick)?;
        if state.tick == self.inner_input.tick {
            state.content.measured = self.inner_input.content.measured;
        }
        match self.theorem.watch(wrench, Some(&state)) {
            Some(replayed) => comparison.compare(tick, &message.content, &replayed.content),
            None => comparison.lacks::<Monitor>(tick, "ticks_checked"),
        }
        Ok(())
    }
}

/// After so many undisturbed ticks, the channels have the same state again.
const GETTING_IN_STEP_TICKS: u64 = 10;

/// A stage, and the process that it replays.
struct Replayed<S> {
    epoch: u64,
    stage: S,
    before: SavedState,
    /// The last state that all channels had, and its tick: after a message that was made from fresh inputs, if none was stale
    /// or left out shortly before.
    fresh: (SavedState, u64),
    last_tick: u64,
    /// The first tick from which on all channels have the same state again, if nothing else happens.
    common_from: u64,
}

/// The next message of a stage.
struct Sent {
    epoch: u64,
    tick: u64,
    /// Whether all of its inputs are of its tick.
    is_fresh: bool,
    /// Whether the flight has several channels.
    is_of_channels: bool,
}

impl Sent {
    fn of(header: &Header, inputs: RangeInclusive<usize>, channels: usize) -> Self {
        Self {
            epoch: header.epoch,
            tick: header.tick,
            is_fresh: header.input_tick[inputs]
                .iter()
                .all(|it| *it == header.tick),
            is_of_channels: channels > 1,
        }
    }
}

/// The stage of the process that sent a message, before it worked that one.
///
/// The state that a new process began with, or that of a channel which takes over, is not in the log. It is the present one,
/// the one before the last message, if a process was killed before it had published its state, the one that another channel
/// had that worked the last ticks with fresh inputs (`redo`), or left them out, or the initial one: the first of them from which the message
/// follows, by `is_it`. A law that cannot be saved begins anew.
fn of_epoch<'a, L: CopyState + ?Sized, M: Field + Clone>(
    replayed: &'a mut Option<Replayed<Guarded<L, M>>>,
    sent: &Sent,
    restarts: &mut u64,
    make: impl Fn() -> Result<Guarded<L, M>, Failure>,
    is_it: impl Fn(&mut Guarded<L, M>) -> bool,
    redo: impl Fn(&mut Guarded<L, M>, u64) -> Option<()>,
) -> Result<&'a mut Replayed<Guarded<L, M>>, Failure> {
    if let Some(last) = replayed.as_mut().filter(|last| last.epoch != sent.epoch) {
        *restarts += 1;
        let mut now = SavedState::new();
        let is_saved = last.stage.save(&mut now);
        let (fresh, fresh_tick) = &last.fresh;
        let none = sent.tick..sent.tick;
        let candidates = [
            (&now, none.clone()),
            (&last.before, none.clone()),
            (fresh, fresh_tick + 1..sent.tick),
            (fresh, none),
        ];
        let mut began = None;
        for (state, ticks) in candidates {
            let build = || -> Result<_, Failure> {
                let mut stage = make()?;
                let is_state = stage.load(state);
                for tick in ticks.clone() {
                    // Where the plant has skipped the tick, there was nothing to work.
                    let _ = redo(&mut stage, tick);
                }
                Ok(is_state.then_some(stage))
            };
            let follows = began.is_none() && build()?.is_some_and(|mut stage| is_it(&mut stage));
            if follows {
                began = build()?;
            }
        }
        // A process whose law cannot be saved is not replaced: the message is of another channel, undisturbed like this one.
        if is_saved || !sent.is_of_channels {
            last.stage = began.map_or_else(&make, Ok)?;
        }
        last.epoch = sent.epoch;
        last.common_from = sent.tick;
    }
    Ok(match replayed {
        Some(replayed) => replayed,
        none => none.insert(Replayed {
            epoch: sent.epoch,
            stage: make()?,
            before: SavedState::new(),
            fresh: (SavedState::new(), 0),
            last_tick: 0,
            common_from: 0,
        }),
    })
}

impl<L: CopyState + ?Sized, M: Field + Clone> Replayed<Guarded<L, M>> {
    /// Works the tick of a message.
    fn work<O>(&mut self, sent: &Sent, tick: impl FnOnce(&mut Guarded<L, M>) -> O) -> O {
        self.stage.save(&mut self.before);
        let output = tick(&mut self.stage);
        if !sent.is_fresh || sent.tick > self.last_tick + 1 {
            self.common_from = sent.tick + GETTING_IN_STEP_TICKS;
        }
        self.last_tick = sent.tick;
        if sent.is_fresh && sent.tick >= self.common_from {
            self.stage.save(&mut self.fresh.0);
            self.fresh.1 = sent.tick;
        }
        output
    }
}
