//! A tick of a flight in one process whose messages or stages have faults.
//!
//! The stages work in the order of the data, as without faults. Between them stand the inlets of their inputs
//! ([`model::fault::inlet`]), and a stage that is out works nothing: the others see its silence as they would see that
//! of a process. Where the plant is out, its next tick flies those that it missed with the commands that were in force.

use std::collections::VecDeque;

use controller::TheoremMonitor;
use law::stage::{InnerStage as _, MixerStage as _, OuterStage as _};
use law::{GuardedInner, GuardedMixer, GuardedOuter};
use model::envelope::{Envelope, Message};
use model::fault::gate::Gate;
use model::fault::inlet::Inlet;
use model::fault::{MessageFaults, Port};
use model::inspection::Rejections;
use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};
use model::role::{Role, STAGES};
use model::topic::Topic;
use plant::latch::PENDING_COMMANDS;

use crate::fault::plan::{Lateness, Planned, StageFault, StageTicks};
use crate::in_process::InProcess;
use crate::settings::Settings;
use failure::Failure;

/// States that are kept for the theorem's monitor: more than a message is ever late.
const KEPT: usize = 128;

/// A law with its priors.
#[allow(clippy::large_enum_variant, reason = "one or two in a flight")]
enum Spare {
    Outer(GuardedOuter),
    Inner(GuardedInner),
    Mixer(GuardedMixer),
}

/// What stands between the stages, and what befalls them.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub(super) struct Faulted {
    /// What takes the place of a law that was killed, with the tick from which on it works.
    spares: Vec<(u64, Spare)>,
    messages: MessageFaults,
    stages: Vec<StageFault>,
    /// First tick that a stage can work after one that took it longer.
    next_tick: [u64; STAGES.len()],
    outer_state: Inlet<State>,
    inner_state: Inlet<State>,
    inner_setpoint: Inlet<Setpoint>,
    mixer_wrench: Inlet<Wrench>,
    /// Rotor commands on their way to the plant, each with the tick from which it may act.
    commands: VecDeque<(Dated<RotorSpeeds>, u64)>,
    /// True states, for the theorem's monitor.
    states: VecDeque<Dated<State>>,
    /// The true state that the inner loop worked with last.
    used: Dated<State>,
    /// The monitor as it begins beside each inner law.
    pub(super) theorem: Option<TheoremMonitor>,
    /// Refused messages of laws that were killed since.
    rejections: Rejections,
}

impl Faulted {
    /// Before tick 0.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub(super) fn new(settings: &Settings, planned: &Planned) -> Result<Self, Failure> {
        let messages = planned.loops.messages;
        let mut spares = Vec::new();
        for fault in planned.stages.iter().filter(|fault| fault.kind == StageTicks::Anew) {
            let spare = match fault.role {
                Role::Outer => Spare::Outer(settings.outer_stage()?),
                Role::Inner => Spare::Inner(settings.inner_stage()?),
                Role::Mixer => Spare::Mixer(settings.mixer_stage()?),
                // A flight ends with its plant, and the recorder is no part of the loop.
                Role::Plant | Role::Record => continue,
            };
            spares.push((fault.span.to, spare));
        }
        let before = Dated { tick: model::messages::NO_TICK, content: State::default() };
        Ok(Self {
            spares,
            messages,
            stages: planned.stages.clone(),
            next_tick: [0; STAGES.len()],
            outer_state: Inlet::new(&messages, Port::OuterState),
            inner_state: Inlet::new(&messages, Port::InnerState),
            inner_setpoint: Inlet::new(&messages, Port::InnerSetpoint),
            mixer_wrench: Inlet::new(&messages, Port::MixerWrench),
            commands: VecDeque::with_capacity(PENDING_COMMANDS + 1),
            states: VecDeque::with_capacity(KEPT + 1),
            used: before,
            theorem: None,
            rejections: Rejections::default(),
        })
    }

    /// The gate of the plant's commands.
    pub(super) fn plant_gate(&self) -> Option<Gate<RotorSpeeds>> {
        Gate::new(&self.messages, Port::PlantRotorSpeeds)
    }

    /// Takes over from a flight without faults of messages and stages, between two ticks.
    pub(super) fn take_over(&mut self, rig: &InProcess) {
        let Some(tick) = rig.tick.checked_sub(1) else { return };
        self.next_tick = [rig.tick; STAGES.len()];
        self.outer_state.arrive(&message(&rig.state));
        self.inner_state.arrive(&message(&rig.state));
        self.inner_setpoint.arrive(&message(&rig.setpoint));
        self.mixer_wrench.arrive(&message(&rig.wrench));
        self.outer_state.settle(tick);
        self.inner_state.settle(tick);
        self.inner_setpoint.settle(tick);
        self.mixer_wrench.settle(tick);
    }

    /// Messages that were refused for what a fault had made of them, those of the plant left out.
    pub(super) fn rejections(&self) -> Rejections {
        self.rejections
            .and(&self.outer_state.rejections())
            .and(&self.inner_state.rejections())
            .and(&self.inner_setpoint.rejections())
            .and(&self.mixer_wrench.rejections())
    }

    /// Flies one tick.
    pub(super) fn tick(&mut self, rig: &mut InProcess) {
        let tick = rig.tick;
        self.begin_anew(tick, rig);
        let plant_works = self.works(Role::Plant, tick);
        if plant_works {
            self.plant(tick, rig);
        }
        if self.works(Role::Outer, tick) {
            let state = self.outer_state.settle(tick);
            let state = Dated { tick: state.envelope.tick, content: state.content };
            if rig.outer.tick_into(tick, &state, &mut rig.setpoint.content) {
                rig.setpoint.tick = tick;
                let late = self.lateness(Role::Outer, tick);
                self.inner_setpoint.arrive_late(&message(&rig.setpoint), late.output);
            }
        }
        if self.works(Role::Inner, tick) {
            self.inner(tick, rig);
        }
        if self.works(Role::Mixer, tick) {
            let wrench = self.mixer_wrench.settle(tick);
            let wrench = Dated { tick: wrench.envelope.tick, content: wrench.content };
            rig.mixer.tick_into(tick, &wrench, &mut rig.rotor_speeds.content);
            rig.rotor_speeds.tick = tick;
            let late = self.lateness(Role::Mixer, tick);
            if self.commands.len() == PENDING_COMMANDS {
                self.commands.pop_front();
            }
            self.commands.push_back((rig.rotor_speeds, tick + 1 + late.output));
        }
        if plant_works {
            rig.plant.finish();
        }
        rig.tick += 1;
    }

    /// The plant's tick: it takes the commands that have come, and publishes the state.
    fn plant(&mut self, tick: u64, rig: &mut InProcess) {
        while let Some((command, acts_from)) = self.commands.pop_front() {
            rig.plant.offer(&command, acts_from);
        }
        rig.plant.begin_into(tick, &mut rig.state.content);
        rig.state.tick = tick;
        rig.envelope = rig.plant.envelope();
        let late = self.lateness(Role::Plant, tick);
        let state = message(&rig.state);
        self.outer_state.arrive_late(&state, late.output);
        self.inner_state.arrive_late(&state, late.output);
        if self.theorem.is_some() {
            if self.states.len() == KEPT {
                self.states.pop_front();
            }
            self.states.push_back(rig.state);
        }
    }

    fn inner(&mut self, tick: u64, rig: &mut InProcess) {
        self.inner_state.settle(tick);
        self.inner_setpoint.settle(tick);
        let (state, setpoint) = (self.inner_state.dated(), self.inner_setpoint.dated());
        rig.inner.tick_into(tick, &state, &setpoint, &mut rig.wrench.content);
        rig.wrench.tick = tick;
        let late = self.lateness(Role::Inner, tick);
        self.mixer_wrench.arrive_late(&message(&rig.wrench), late.output);
        rig.monitor = None;
        if let Some(theorem) = &mut rig.theorem {
            while self.states.front().is_some_and(|first| first.tick <= state.tick) {
                self.used = self.states.pop_front().unwrap_or(self.used);
            }
            rig.monitor = Some(*theorem.watch(tick, &self.used, &rig.wrench.content));
        }
    }

    /// Puts new laws in the place of those that were killed and begin again at this tick; nothing has come to them yet.
    fn begin_anew(&mut self, tick: u64, rig: &mut InProcess) {
        let is_due = |(from, _): &mut (u64, Spare)| *from == tick;
        for (_, spare) in self.spares.extract_if(.., is_due) {
            let messages = &self.messages;
            match spare {
                Spare::Outer(outer) => {
                    rig.outer = outer;
                    self.rejections = self.rejections.and(&self.outer_state.rejections());
                    self.outer_state = Inlet::new(messages, Port::OuterState);
                }
                Spare::Inner(inner) => {
                    rig.inner = inner;
                    rig.theorem.clone_from(&self.theorem);
                    let refused = self.inner_state.rejections().and(&self.inner_setpoint.rejections());
                    self.rejections = self.rejections.and(&refused);
                    self.inner_state = Inlet::new(messages, Port::InnerState);
                    self.inner_setpoint = Inlet::new(messages, Port::InnerSetpoint);
                }
                Spare::Mixer(mixer) => {
                    rig.mixer = mixer;
                    self.rejections = self.rejections.and(&self.mixer_wrench.rejections());
                    self.mixer_wrench = Inlet::new(messages, Port::MixerWrench);
                }
            }
        }
    }

    fn works(&self, role: Role, tick: u64) -> bool {
        let is_out = |fault: &StageFault| {
            fault.role == role && fault.span.holds(tick) && !matches!(fault.kind, StageTicks::Late { .. })
        };
        self.next_tick[role as usize] <= tick && !self.stages.iter().any(is_out)
    }

    /// What becomes of a tick that a stage has worked.
    fn lateness(&mut self, role: Role, tick: u64) -> Lateness {
        let late = self.stages.iter().find(|fault| fault.role == role && fault.span.holds(tick));
        let late =
            late.map_or(Lateness { output: 0, next: 1 }, |fault| fault.kind.lateness(role, self.messages.seed, tick));
        self.next_tick[role as usize] = tick + late.next;
        late
    }
}

/// As a process would have sent it.
fn message<C: Topic>(dated: &Dated<C>) -> Message<C> {
    Message { envelope: Envelope { tick: dated.tick, ..Envelope::new() }, content: dated.content }
}
