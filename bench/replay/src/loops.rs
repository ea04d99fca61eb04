//! Replays outer loop, inner loop and mixer of a channel, each from the state and the inputs that its messages name.

use std::collections::{BTreeMap, VecDeque};

use control_api::guard::Guarded;
use control_api::law::CopyState;
use control_api::saved_state::Field;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use faults::Port;
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::{Header, Message};
use messages::history::LawState;
use messages::message_window::MessageWindow;
use messages::role::{Channel, Replica, Role};

use crate::comparison::ReplayComparison;
use crate::inputs::RecordedInput;
use analysis::states::is_final_command;
use config::Settings;
use errors::Failure;
use flight_log::codec::Logged;
use sim::expected_messages::gap;

/// A state of a stage, with its tick and history.
type DatedState = ((u64, u64), Vec<u8>);

/// States of the stages of all channels after their last messages.
pub struct SavedStates {
    /// So many of each stage.
    kept: usize,
    states: BTreeMap<Replica, VecDeque<DatedState>>,
}

impl SavedStates {
    pub const fn keeping(kept: usize) -> Self {
        Self {
            kept,
            states: BTreeMap::new(),
        }
    }

    fn push(&mut self, stage: Replica, of: (u64, u64), state: &SavedState) {
        let states = self.states.entry(stage).or_default();
        let is_full = states.len() == self.kept;
        let (_, mut place) = states.pop_front_if(|_| is_full).unwrap_or_default();
        place.clear();
        place.extend_from_slice(state);
        states.push_back((of, place));
    }

    fn of(&self, stage: Replica, of: (u64, u64)) -> Option<&[u8]> {
        let mut states = self.states.get(&stage)?.iter().rev();
        let (_, state) = states.find(|(it, _)| *it == of)?;
        Some(state)
    }
}

pub struct LoopsReplay {
    settings: Settings,
    channel: Channel,
    outer: Option<Replayed<GuardedOuter>>,
    inner: Option<Replayed<GuardedInner>>,
    mixer: Option<Replayed<GuardedMixer>>,
    pub states: MessageWindow<State>,
    setpoints: MessageWindow<Setpoint>,
    wrenches: MessageWindow<Wrench>,
    outer_state: RecordedInput<State>,
    inner_state: RecordedInput<State>,
    inner_setpoint: RecordedInput<Setpoint>,
    mixer_wrench: RecordedInput<Wrench>,
    /// The true state with a faulty measurement, for the monitor.
    faulty_state: Stamped<State>,
    /// Of the inner loop.
    pub restarts: u64,
    /// Messages that continue from the state of another process.
    pub takeovers: u64,
    /// Whether the inner law is another program, whose answers cannot be computed again.
    inner_is_program: bool,
}

impl LoopsReplay {
    /// The laws as they are started.
    pub fn new(settings: &Settings, channel: Channel, kept: usize) -> Result<Self, Failure> {
        // A law that cannot be created is refused here rather than during the replay.
        settings.outer_stage()?;
        let inner_is_program = firmware::is_program(settings.laws()?[1].name);
        if !inner_is_program {
            settings.inner_stage()?;
        }
        settings.mixer_stage()?;
        let faults = settings.planned()?.loops.messages;
        Ok(Self {
            settings: settings.clone(),
            channel,
            outer: None,
            inner: None,
            mixer: None,
            states: MessageWindow::keeping(kept),
            setpoints: MessageWindow::keeping(kept),
            wrenches: MessageWindow::keeping(kept),
            outer_state: RecordedInput::new(&faults, Port::OuterState, kept),
            inner_state: RecordedInput::new(&faults, Port::InnerState, kept),
            inner_setpoint: RecordedInput::new(&faults, Port::InnerSetpoint, kept),
            mixer_wrench: RecordedInput::new(&faults, Port::MixerWrench, kept),
            faulty_state: Stamped::never(),
            restarts: 0,
            takeovers: 0,
            inner_is_program,
        })
    }

    pub fn take_state(&mut self, message: &Message<State>) {
        self.states.push(message);
        self.outer_state.take(message);
        self.inner_state.take(message);
    }

    pub fn setpoint(
        &mut self,
        message: &Message<Setpoint>,
        states: &mut SavedStates,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        let Message { envelope, content } = message;
        let (tick, input_tick) = (envelope.tick, envelope.input_tick);
        self.setpoints.push(message);
        self.inner_setpoint.take(message);
        let state = self.outer_state.input(&self.states, input_tick[0], tick)?;
        let (mut setpoint, mut is_published) = (Setpoint::default(), false);
        let work = Replayed::work(
            &mut self.outer,
            (Replica::new(Role::Outer, self.channel), envelope),
            states,
            || self.settings.outer_stage(),
            |outer| is_published = outer.tick_into(tick, state, &mut setpoint),
        )?;
        self.takeovers += u64::from(work.is_takeover);
        if is_published {
            comparison.compare(tick, content, &setpoint);
        } else {
            comparison.lacks::<Setpoint>(tick, "thrust_n");
        }
        let inputs = [self.outer_state.history(&self.states, input_tick[0])];
        check_history::<Setpoint>(envelope, &inputs, comparison);
        Ok(())
    }

    /// Replays a wrench; a restart before it is counted if the wrench is.
    pub fn wrench(
        &mut self,
        message: &Message<Wrench>,
        is_counted: bool,
        states: &mut SavedStates,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        let Message { envelope, content } = message;
        let (tick, input_tick) = (envelope.tick, envelope.input_tick);
        self.wrenches.push(message);
        self.mixer_wrench.take(message);
        if self.inner_is_program {
            comparison.foreign += 1;
            return Ok(());
        }
        let state = self.inner_state.input(&self.states, input_tick[0], tick)?;
        let setpoint = self
            .inner_setpoint
            .input(&self.setpoints, input_tick[1], tick)?;
        let mut wrench = Wrench::default();
        let work = Replayed::work(
            &mut self.inner,
            (Replica::new(Role::Inner, self.channel), envelope),
            states,
            || self.settings.inner_stage(),
            |inner| inner.tick_into(tick, state, setpoint, &mut wrench),
        )?;
        self.restarts += u64::from(work.is_restart && is_counted);
        self.takeovers += u64::from(work.is_takeover);
        comparison.compare(tick, content, &wrench);
        let inputs = [
            self.inner_setpoint.history(&self.setpoints, input_tick[1]),
            self.inner_state.history(&self.states, input_tick[0]),
        ];
        check_history::<Wrench>(envelope, &inputs, comparison);
        Ok(())
    }

    pub fn rotor_speeds(
        &mut self,
        message: &Message<RotorSpeeds>,
        states: &mut SavedStates,
        comparison: &mut ReplayComparison,
    ) -> Result<(), Failure> {
        let Message { envelope, content } = message;
        let (tick, input_tick) = (envelope.tick, envelope.input_tick);
        let is_final = is_final_command(message);
        if is_final {
            // It idles the rotors, whatever state the law had.
            let idle = self.settings.mixer_stage()?.idle();
            comparison.compare(tick, content, &idle);
            return Ok(());
        }
        let wrench = self
            .mixer_wrench
            .input(&self.wrenches, input_tick[2], tick)?;
        let mut speeds = RotorSpeeds::default();
        let work = Replayed::work(
            &mut self.mixer,
            (Replica::new(Role::Mixer, self.channel), envelope),
            states,
            || self.settings.mixer_stage(),
            |mixer| mixer.tick_into(tick, wrench, &mut speeds),
        )?;
        self.takeovers += u64::from(work.is_takeover);
        comparison.compare(tick, content, &speeds);
        let inputs = [self.mixer_wrench.history(&self.wrenches, input_tick[2])];
        check_history::<RotorSpeeds>(envelope, &inputs, comparison);
        Ok(())
    }

    /// The true state that a wrench goes back to, with the measurement that the inner loop had of it; none where it is not
    /// known.
    pub fn monitored(
        &mut self,
        wrench: &Message<Wrench>,
    ) -> Result<Option<&Stamped<State>>, Failure> {
        let Header { tick, .. } = wrench.envelope;
        let of_state = wrench.envelope.input_tick[0];
        let had = self.inner_state.input(&self.states, of_state, tick)?;
        if !self.inner_state.has_faults() {
            return Ok(Some(had));
        }
        if self
            .states
            .input_kept(of_state, &mut self.faulty_state)
            .is_none()
        {
            return Ok(None);
        }
        self.faulty_state.content.measured = had.content.measured;
        Ok(Some(&self.faulty_state))
    }
}

/// Compares the history that a message names with that of its state and its inputs.
fn check_history<C: Logged>(
    envelope: &Header,
    inputs: &[(u64, u64)],
    comparison: &mut ReplayComparison,
) {
    let recorded = envelope.law_state;
    let mut replayed = recorded;
    replayed.advance(envelope.tick, inputs.iter().copied());
    if replayed.after != recorded.after {
        let histories = [recorded.after, replayed.after].map(|it| format!("{it}"));
        comparison.differs::<C>(envelope.tick, "envelope.law_state.after", histories);
    }
}

/// A stage, and the process that it replays.
struct Replayed<S> {
    epoch: u64,
    /// Tick of its last message, and the history of its state after that.
    of: (u64, u64),
    stage: S,
}

/// How a stage came to a message.
struct Work {
    /// Whether it is the first message of a process that has replaced another one.
    is_restart: bool,
    is_takeover: bool,
}

impl<L: CopyState + ?Sized, M: Field + Clone> Replayed<Guarded<L, M>> {
    /// Works a tick from the state that the message names: that after the stage's own last message, the initial one, or
    /// that of another process after a tick.
    fn work(
        replayed: &mut Option<Self>,
        (replica, header): (Replica, &Header),
        states: &mut SavedStates,
        make: impl Fn() -> Result<Guarded<L, M>, Failure>,
        tick: impl FnOnce(&mut Guarded<L, M>),
    ) -> Result<Work, Failure> {
        let LawState {
            from_tick: from,
            channel,
            before,
            after,
        } = header.law_state;
        let (of, is_own) = ((from, before), channel == replica.channel as u64);
        let is_restart = replayed.as_ref().is_some_and(|it| it.epoch != header.epoch);
        let mut room = SavedState::new();
        let work = match replayed {
            Some(last) if from != NO_TICK && is_own && last.of == of => {
                if is_restart {
                    last.stage.replace_by(make()?, &mut room);
                }
                last
            }
            _ => {
                let last = replayed.take();
                let own = last.filter(|_| from != NO_TICK && !is_restart);
                let mut stage = own.map_or_else(&make, |it| Ok(it.stage))?;
                let twin = Channel::from_wire(channel).map(|it| Replica::new(replica.role, it));
                let state = || states.of(twin?, of);
                if from != NO_TICK && !state().is_some_and(|state| stage.load(state)) {
                    return Err(gap(&format!(
                        "at tick {} stage {replica} continued from the state of channel {} after tick {from}, which is not \
                         in it",
                        header.tick,
                        twin.map_or("?", |it| it.channel.name()),
                    )));
                }
                let epoch = header.epoch;
                replayed.insert(Self { epoch, of, stage })
            }
        };
        tick(&mut work.stage);
        (work.epoch, work.of) = (header.epoch, (header.tick, after));
        if work.stage.save(&mut room) {
            states.push(replica, work.of, &room);
        }
        Ok(Work {
            is_restart,
            is_takeover: from != NO_TICK && (is_restart || !is_own),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::telemetry::Signals;

    #[test]
    fn messages_of_another_program_are_counted_and_not_compared() {
        let settings = Settings::resolve(None, &Vec::new()).unwrap();
        let mut loops = LoopsReplay::new(&settings, Channel::A, 16).unwrap();
        loops.inner_is_program = true;
        let mut states = SavedStates::keeping(16);
        let mut comparison = ReplayComparison::from(0, Channel::A, Signals::default());
        for _ in 0..3 {
            let message = Message::<Wrench>::default();
            let replayed = loops.wrench(&message, true, &mut states, &mut comparison);
            assert!(replayed.is_ok(), "{replayed:?}");
        }
        assert_eq!((comparison.foreign, comparison.values), (3, 0));
    }
}
