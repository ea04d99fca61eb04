//! Replays outer loop, inner loop, mixer and the theorem's monitor, each on the inputs that its messages name.

use control_api::guard::Guarded;
use control_api::law::CopyState;
use control_api::saved_state::Field;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use faults::Port;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::{Header, Message};
use messages::layout::Visit as _;
use messages::monitor::Monitor;
use messages::role::{Channel, Replica, Role};

use crate::comparison::ReplayComparison;
use crate::inputs::{Inputs, RecordedInput, input, of};
use crate::stage_states::StageStates;
use analysis::states::is_final_command;
use config::Settings;
use controller::flight_monitor::FlightMonitor;
use errors::Failure;

/// Outer loop, inner loop and mixer of a channel, and the theorem's monitor.
pub struct LoopsReplay {
    settings: Settings,
    channel: Channel,
    outer: Option<Replayed<GuardedOuter>>,
    inner: Option<Replayed<GuardedInner>>,
    mixer: Option<Replayed<GuardedMixer>>,
    outer_state: RecordedInput<State>,
    inner_state: RecordedInput<State>,
    inner_setpoint: RecordedInput<Setpoint>,
    mixer_wrench: RecordedInput<Wrench>,
    theorem: FlightMonitor,
    /// Of the inner loop.
    pub restarts: u64,
    /// Messages that follow only from the state of another channel, or of the process before.
    pub takeovers: u64,
}

impl LoopsReplay {
    /// The laws as they are started.
    pub fn new(settings: &Settings, channel: Channel) -> Result<Self, Failure> {
        // A law that cannot be created is refused here rather than during the replay.
        settings.outer_stage()?;
        settings.inner_stage()?;
        settings.mixer_stage()?;
        let faults = settings.planned()?.loops.messages;
        Ok(Self {
            settings: settings.clone(),
            channel,
            outer: None,
            inner: None,
            mixer: None,
            outer_state: RecordedInput::new(&faults, Port::OuterState),
            inner_state: RecordedInput::new(&faults, Port::InnerState),
            inner_setpoint: RecordedInput::new(&faults, Port::InnerSetpoint),
            mixer_wrench: RecordedInput::new(&faults, Port::MixerWrench),
            theorem: FlightMonitor::new(settings.theorem()?, settings.rt.channels),
            restarts: 0,
            takeovers: 0,
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
        states: &mut StageStates,
        comparison: &mut ReplayComparison,
    ) -> Result<Option<Setpoint>, Failure> {
        let Message { envelope, content } = message;
        let tick = envelope.tick;
        let state = self
            .outer_state
            .input(&inputs.states, envelope.input_tick[0], tick)?;
        let output = Replayed::work(
            &mut self.outer,
            (Replica::new(Role::Outer, self.channel), envelope),
            states,
            || self.settings.outer_stage(),
            |outer| outer.tick(tick, &state),
            |output| output.is_some_and(|it| it.is_same(content)),
        )?;
        self.takeovers += u64::from(output.is_takeover);
        match &output.content {
            Some(setpoint) => comparison.compare(tick, content, setpoint),
            None => comparison.lacks::<Setpoint>(tick, "thrust_n"),
        }
        Ok(output.content)
    }

    pub fn wrench(
        &mut self,
        message: &Message<Wrench>,
        inputs: &Inputs,
        states: &mut StageStates,
        comparison: &mut ReplayComparison,
    ) -> Result<Wrench, Failure> {
        let Message { envelope, content } = message;
        let tick = envelope.tick;
        let state = self
            .inner_state
            .input(&inputs.states, envelope.input_tick[0], tick)?;
        let setpoint =
            self.inner_setpoint
                .input(&inputs.setpoints, envelope.input_tick[1], tick)?;
        let output = Replayed::work(
            &mut self.inner,
            (Replica::new(Role::Inner, self.channel), envelope),
            states,
            || self.settings.inner_stage(),
            |inner| inner.tick(tick, &state, &setpoint),
            |output| output.is_same(content),
        )?;
        self.restarts += u64::from(output.is_new);
        self.takeovers += u64::from(output.is_takeover);
        comparison.compare(tick, content, &output.content);
        Ok(output.content)
    }

    pub fn rotor_speeds(
        &mut self,
        message: &Message<RotorSpeeds>,
        inputs: &Inputs,
        states: &mut StageStates,
        comparison: &mut ReplayComparison,
    ) -> Result<RotorSpeeds, Failure> {
        let Message { envelope, content } = message;
        let tick = envelope.tick;
        let is_final = is_final_command(message);
        let wrench = if is_final {
            Stamped::never()
        } else {
            self.mixer_wrench
                .input(&inputs.wrenches, envelope.input_tick[2], tick)?
        };
        let output = Replayed::work(
            &mut self.mixer,
            (Replica::new(Role::Mixer, self.channel), envelope),
            states,
            || self.settings.mixer_stage(),
            |mixer| match is_final {
                true => mixer.idle(),
                false => mixer.tick(tick, &wrench),
            },
            |output| output.is_same(content),
        )?;
        self.takeovers += u64::from(output.is_takeover);
        comparison.compare(tick, content, &output.content);
        Ok(output.content)
    }

    pub fn theorem(
        &mut self,
        message: &Message<Monitor>,
        inputs: &Inputs,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        let tick = message.envelope.tick;
        let wrench = of(&inputs.wrenches, tick)?;
        let input_tick = wrench.envelope.input_tick[0];
        let mut state = input(&inputs.states, input_tick, tick)?;
        let faulty = self.inner_state.input(&inputs.states, input_tick, tick)?;
        state.content.measured = faulty.content.measured;
        match self.theorem.watch(wrench, Some(&state)) {
            Some(replayed) => comparison.compare(tick, &message.content, &replayed.content),
            None => comparison.lacks::<Monitor>(tick, "ticks_checked"),
        }
        Ok(())
    }
}

/// States of a stage that are kept beside the first one that a message follows from.
const MOST_OTHERS: usize = 256;

/// A stage, and the process that it replays.
struct Replayed<S> {
    epoch: u64,
    stage: S,
    /// States that it may have instead: its messages with stale inputs follow from them, too.
    others: Vec<Vec<u8>>,
}

/// What a stage sent, replayed.
struct Output<O> {
    content: O,
    /// Whether it is the first message of a process that has replaced another one.
    is_new: bool,
    is_takeover: bool,
}

impl<L: CopyState + ?Sized, M: Field + Clone> Replayed<Guarded<L, M>> {
    /// Replays a message, for which `is_it` is true of the output.
    ///
    /// The log does not say from which state a stage continued that was disturbed or is new: its own, that of the process
    /// before it, or one of another channel. It is the first of them from which the message follows. A message with stale
    /// inputs may follow from several: the others are kept until one with fresh inputs decides. A new process whose law
    /// cannot be saved begins with the initial state.
    fn work<O>(
        replayed: &mut Option<Self>,
        (replica, header): (Replica, &Header),
        states: &mut StageStates,
        make: impl Fn() -> Result<Guarded<L, M>, Failure>,
        tick: impl Fn(&mut Guarded<L, M>) -> O,
        is_it: impl Fn(&O) -> bool,
    ) -> Result<Output<O>, Failure> {
        let epoch = header.epoch;
        let last = replayed.take();
        let is_new = last.as_ref().is_some_and(|it| it.epoch != epoch);
        let has_own = states.of(replica).next().is_some();
        let (stage, others) = match last {
            Some(last) if !is_new || has_own => (last.stage, last.others),
            _ => (make()?, Vec::new()),
        };
        let Self { stage, others, .. } = replayed.insert(Self {
            epoch,
            stage,
            others,
        });
        let mut content = tick(stage);
        let mut is_takeover = false;
        if !is_it(&content) {
            let before = states.of(replica).skip(1).filter(|_| is_new);
            let mut candidates = others
                .iter()
                .map(Vec::as_slice)
                .chain(before)
                .chain(states.of_twins(replica));
            let found = candidates.find_map(|state| {
                let content = stage.load(state).then(|| tick(stage))?;
                is_it(&content).then_some(content)
            });
            is_takeover = found.is_some();
            content = if let Some(found) = found {
                found
            } else {
                // It differs, and goes on from its own state.
                let own = states.of(replica).next().filter(|_| !is_new);
                if !own.is_some_and(|own| stage.load(own)) {
                    *stage = make()?;
                }
                tick(stage)
            };
        }
        let mut state = SavedState::new();
        if stage.save(&mut state) {
            let is_stale = |it: &u64| ![header.tick, NO_TICK].contains(it);
            let before = std::mem::take(others);
            if header.input_tick.iter().any(is_stale) {
                let twins = states.of_twins(replica).map(<[u8]>::to_vec);
                *others = after(stage, &state, twins.chain(before), |it| is_it(&tick(it)));
                stage.load(&state);
            }
            states.push(replica, &state);
        }
        Ok(Output {
            content,
            is_new,
            is_takeover,
        })
    }
}

/// The states of a stage after a message that follows from some of the `candidates`, `does` replaying it; without `known`.
fn after<L: CopyState + ?Sized, M: Field + Clone>(
    stage: &mut Guarded<L, M>,
    known: &[u8],
    candidates: impl Iterator<Item = Vec<u8>>,
    does: impl Fn(&mut Guarded<L, M>) -> bool,
) -> Vec<Vec<u8>> {
    let (mut all, mut state) = (Vec::new(), SavedState::new());
    for candidate in candidates {
        let follows = stage.load(&candidate) && does(stage) && stage.save(&mut state);
        let is_new = known != &state[..] && all.iter().all(|it: &Vec<u8>| it[..] != state[..]);
        if follows && is_new && all.len() < MOST_OTHERS {
            all.push(state.to_vec());
        }
    }
    all
}
