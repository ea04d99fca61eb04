//! The simulator: a flight in one process, with the four tick functions called in the order of the data.
//!
//! plant -> outer -> inner -> mixer -> plant. Without transport, clock or deadlines every command is on time. Four
//! processes that miss no deadline reproduce this flight bit by bit. Nothing is allocated after [`Simulator::new`].
//!
//! With message or stage faults, the stages read their inputs through [`faults::filter`]. A stage in an
//! outage does nothing, and the others see it silent, like a stopped process. After an outage of the plant, its next tick
//! integrates the missed ones with the commands active then. The last tick is always flown.

pub mod simulated_flight;
pub mod timed;

use std::collections::VecDeque;
use std::mem::replace;

use analysis::states::Joined;
use control_api::guard::Route;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, SavedState};
use controller::{FlightMonitor, TheoremMonitor};
use errors::Failure;
use faults::filter::{FaultFilter, FaultyInput};
use faults::{MessageFaults, Port, StageTicks, Target};
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::header::Message;
use messages::inspection::Rejections;
use messages::monitor::Monitor;
use messages::role::{Role, STAGES};
use messages::topic::Topic;
use plant::command_hold::pending_commands;
use plant::{EnvelopeViolation, Plant};

use config::Settings;
use faults::plan::{Lateness, Planned, StageFault};

pub struct Simulator {
    plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    mixer: GuardedMixer,
    state: Stamped<State>,
    setpoint: Stamped<Setpoint>,
    wrench: Stamped<Wrench>,
    rotor_speeds: Stamped<RotorSpeeds>,
    tick: u64,
    envelope: Result<(), EnvelopeViolation>,
    theorem: FlightMonitor,
    /// Message and stage faults; none takes the fast path.
    faulted: Option<Box<Faulted>>,
}

impl Simulator {
    pub fn new(
        plant: &plant::PlantSettings,
        outer: GuardedOuter,
        inner: GuardedInner,
        mixer: GuardedMixer,
    ) -> Self {
        Self {
            plant: Plant::new(plant),
            outer,
            inner,
            mixer,
            state: Stamped::never(),
            setpoint: Stamped::never(),
            wrench: Stamped::never(),
            rotor_speeds: Stamped::never(),
            tick: 0,
            envelope: Ok(()),
            theorem: FlightMonitor::new(None),
            faulted: None,
        }
    }

    /// The flight that settings describe, with its faults.
    pub fn of(settings: &Settings) -> Result<Self, Failure> {
        Self::faulty(settings, settings.outer_stage()?, settings.inner_stage()?)
    }

    /// The same with other loops than the settings name.
    pub fn with(
        settings: &Settings,
        outer: GuardedOuter,
        inner: GuardedInner,
    ) -> Result<Self, Failure> {
        let is_lost = |fault: &&StageFault| fault.starts_anew() && fault.role != Role::Mixer;
        if let Some(fault) = settings.planned()?.stages.iter().find(is_lost) {
            return Err(Failure::usage(format!(
                "{}.kill: this law was passed as an object and cannot be created again",
                fault.role
            ))
            .help("stop the stage instead, or name a law in the settings"));
        }
        Self::faulty(settings, outer, inner)
    }

    fn faulty(
        settings: &Settings,
        outer: GuardedOuter,
        inner: GuardedInner,
    ) -> Result<Self, Failure> {
        let (mixer, plant) = (settings.mixer_stage()?, settings.plant()?);
        if plant.follows_targets {
            return Err(Failure::usage(
                "trajectory mavlink is flown by a ground station, which a simulation does not have",
            )
            .help("fly it: `ironbird fly --trajectory mavlink --mavlink --allow-control`; or choose another one, such as hover"));
        }
        let mut rig = Self::new(&plant, outer, inner, mixer);
        if settings.has_several_laws() {
            return Err(Failure::usage(
                "channels fly different laws, and a simulation flies one channel: leave out the sections of channels, or fly \
                 them with `ironbird fly`",
            ));
        }
        let planned = settings.planned()?;
        let faults = settings.typed_faults();
        let faults = faults.map_err(|e| Failure::usage(format!("fault: {e}")))?;
        for change in faults.iter().flat_map(|fault| &fault.changes) {
            let kinds = change.kinds();
            let why = if kinds
                .iter()
                .any(|(kind, _)| matches!(kind.target, Target::Processor(_)))
            {
                "ticks of a simulation need no processor"
            } else if kinds.iter().any(|(kind, _)| kind.channel().is_some()) {
                "a simulation flies one channel"
            } else {
                continue;
            };
            let what = change.what();
            return Err(Failure::usage(format!(
                "fault: {what}: {why}: leave it out, or fly it with `ironbird fly`"
            )));
        }
        if !planned.has_no_loop_faults() {
            let faulted = Faulted::new(settings, &planned)?;
            rig.plant.set_fault_filter(faulted.plant_filter());
            rig.faulted = Some(Box::new(faulted));
        }
        for swap in planned.swaps {
            rig.plant
                .schedule(swap)
                .map_err(|e| Failure::usage(format!("fault: {e}")))?;
        }
        Ok(rig)
    }

    /// With the references of another route.
    pub fn along(self, route: Route) -> Self {
        Self {
            outer: self.outer.along(route),
            ..self
        }
    }

    /// Adds the theorem's monitor, if the inner law has a theorem.
    pub fn with_monitor(self, theorem: Option<TheoremMonitor>) -> Self {
        Self {
            theorem: FlightMonitor::new(theorem),
            ..self
        }
    }

    /// A copy of this flight that continues under other settings, which may differ in message and stage faults that begin
    /// at least 60 ticks later (some look back). None if a law cannot be copied.
    pub fn branch(&self, settings: &Settings) -> Result<Option<Box<Self>>, Failure> {
        let mut rig = Box::new(Self::of(settings)?);
        let is_copied = rig.outer.copy_from(&self.outer)
            && rig.inner.copy_from(&self.inner)
            && rig.mixer.copy_from(&self.mixer);
        if !is_copied {
            return Ok(None);
        }
        rig.plant.clone_from(&self.plant);
        if let Some(faulted) = &mut rig.faulted {
            rig.plant.set_fault_filter(faulted.plant_filter());
            faulted.take_over(self);
        }
        rig.state = self.state;
        rig.setpoint = self.setpoint;
        rig.wrench = self.wrench;
        rig.rotor_speeds = self.rotor_speeds;
        rig.tick = self.tick;
        rig.envelope = self.envelope;
        Ok(Some(rig))
    }

    /// Starts what the inner law needs outside of this process, before the first tick.
    pub fn start(&mut self) -> Result<(), Failure> {
        let started = self.inner.start(false);
        started.map_err(|e| Failure::failed(e.to_string()))
    }

    pub fn tick(&mut self) {
        self.stages();
        self.plant.finish();
    }

    /// Judges the command of the last tick, as a flight of processes does at its end.
    pub fn end(&mut self) {
        if let Some(faulted) = &mut self.faulted {
            faulted.offer(&mut self.plant);
        }
        let end = self.plant.end(self.flown_tick());
        self.state.content.deadlines_missed = end.deadlines_missed;
    }

    /// A tick without the rest of the plant's, which [`Plant::finish`] flies.
    pub(crate) fn stages(&mut self) {
        if self.faulted.is_some() {
            self.faulty_tick();
            return;
        }
        let Self {
            plant,
            outer,
            inner,
            mixer,
            state,
            setpoint,
            wrench,
            rotor_speeds,
            tick,
            ..
        } = self;
        let tick = *tick;
        plant.begin_into(tick, &mut state.content);
        state.tick = tick;
        self.envelope = plant.envelope();
        if outer.tick_into(tick, state, &mut setpoint.content) {
            setpoint.tick = tick;
        }
        inner.tick_into(tick, state, setpoint, &mut wrench.content);
        wrench.tick = tick;
        mixer.tick_into(tick, wrench, &mut rotor_speeds.content);
        rotor_speeds.tick = tick;
        plant.offer(rotor_speeds, tick + 1);
        self.theorem
            .watch_next(tick, state, setpoint, &wrench.content);
        self.theorem.command(tick, &rotor_speeds.content);
        self.tick += 1;
    }

    #[cold]
    fn faulty_tick(&mut self) {
        if let Some(mut faulted) = self.faulted.take() {
            faulted.tick(self);
            self.faulted = Some(faulted);
        }
    }

    /// The last tick; [`NO_TICK`] before the first.
    pub const fn flown_tick(&self) -> u64 {
        self.tick.wrapping_sub(1)
    }

    pub const fn next_tick(&self) -> u64 {
        self.tick
    }

    /// Whether the plant published a state in the last tick: not during its outage.
    pub const fn has_state(&self) -> bool {
        self.state.tick == self.flown_tick()
    }

    /// Messages that inspection rejected after a fault.
    pub fn rejections(&self) -> Rejections {
        let of_stages = self
            .faulted
            .as_ref()
            .map(|faulted| faulted.rejections())
            .unwrap_or_default();
        of_stages.and(&self.plant.rejections())
    }

    /// State of the last tick; an older one during an outage of the plant.
    pub const fn state(&self) -> &State {
        &self.state.content
    }

    /// The setpoint of the last tick, if there is one.
    pub fn setpoint(&self) -> Option<&Setpoint> {
        (self.setpoint.tick == self.flown_tick()).then_some(&self.setpoint.content)
    }

    pub const fn wrench(&self) -> &Wrench {
        &self.wrench.content
    }

    pub const fn rotor_speeds(&self) -> &RotorSpeeds {
        &self.rotor_speeds.content
    }

    /// The wrench of the last tick, if there is one.
    pub fn new_wrench(&self) -> Option<&Wrench> {
        (self.wrench.tick == self.flown_tick()).then_some(&self.wrench.content)
    }

    /// The rotor command of the last tick, if there is one.
    pub fn new_rotor_speeds(&self) -> Option<&RotorSpeeds> {
        (self.rotor_speeds.tick == self.flown_tick()).then_some(&self.rotor_speeds.content)
    }

    /// The state with the outputs of the stages.
    pub fn joined(&self) -> Joined {
        let wrench = self.new_wrench().copied();
        Joined {
            tick: self.flown_tick(),
            state: *self.state(),
            setpoint: self.setpoint().copied(),
            wrench,
            rotor_speeds: self.new_rotor_speeds().copied(),
            monitor: self.monitor().filter(|_| wrench.is_some()).copied(),
        }
    }

    /// Result of the theorem's monitor for the newest wrench.
    pub fn monitor(&self) -> Option<&Monitor> {
        self.theorem.newest()
    }

    pub const fn theorem(&self) -> &FlightMonitor {
        &self.theorem
    }

    /// Checks the newest wrench, and the state and setpoint that it was computed from, against the theorem.
    fn watch(&mut self, state: &Stamped<State>, setpoint: &Stamped<Setpoint>) {
        let wrench = &self.wrench;
        self.theorem
            .watch_next(wrench.tick, state, setpoint, &wrench.content);
    }

    /// Whether the last state is inside the model's envelope.
    pub const fn envelope(&self) -> Result<(), EnvelopeViolation> {
        self.envelope
    }

    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The plant, to schedule swaps between ticks.
    pub fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }
}

/// States kept for the theorem's monitor: more than the longest delay.
const KEPT: usize = 128;

#[allow(clippy::large_enum_variant, reason = "one or two in a flight")]
enum Replacement {
    Outer(GuardedOuter),
    Inner(GuardedInner),
    Mixer(GuardedMixer),
}

/// Faulty inputs, outages and delays of the stages.
struct Faulted {
    /// Laws that replace killed ones, each with its first tick.
    replacements: Vec<(u64, Replacement)>,
    messages: MessageFaults,
    stages: Vec<StageFault>,
    /// First tick in which a stage can run after a long one.
    next_tick: [u64; STAGES.len()],
    last_tick: u64,
    outer_state: FaultyInput<State>,
    inner_state: FaultyInput<State>,
    inner_setpoint: FaultyInput<Setpoint>,
    mixer_wrench: FaultyInput<Wrench>,
    /// Rotor commands sent to the plant, each with the first tick in which it may act; as many as its port keeps.
    commands: VecDeque<(Stamped<RotorSpeeds>, u64)>,
    port_depth: usize,
    /// States, for the theorem's monitor: their truth is that of their tick.
    states: VecDeque<Stamped<State>>,
    /// The true state that the inner loop worked with last.
    used: Stamped<State>,
    /// Rejections counted by the inputs of killed laws.
    rejections: Rejections,
}

impl Faulted {
    fn new(settings: &Settings, planned: &Planned) -> Result<Self, Failure> {
        let messages = planned.loops.messages;
        let mut replacements = Vec::new();
        for fault in planned.stages.iter().filter(|fault| fault.starts_anew()) {
            let replacement = match fault.role {
                Role::Outer => Replacement::Outer(settings.outer_stage()?),
                Role::Inner => Replacement::Inner(settings.inner_stage()?),
                Role::Mixer => Replacement::Mixer(settings.mixer_stage()?),
                // The flight ends with the plant; the recorder is not part of the loop.
                Role::Plant | Role::Record => continue,
            };
            replacements.push((fault.span.to, replacement));
        }
        let port_depth = pending_commands(settings.flight.period_s);
        Ok(Self {
            replacements,
            messages,
            stages: planned.stages.clone(),
            next_tick: [0; STAGES.len()],
            last_tick: settings.last_tick(),
            outer_state: FaultyInput::new(&messages, Port::OuterState),
            inner_state: FaultyInput::new(&messages, Port::InnerState),
            inner_setpoint: FaultyInput::new(&messages, Port::InnerSetpoint),
            mixer_wrench: FaultyInput::new(&messages, Port::MixerWrench),
            commands: VecDeque::with_capacity(port_depth + 1),
            port_depth,
            states: VecDeque::with_capacity(KEPT + 1),
            used: Stamped::never(),
            rejections: Rejections::default(),
        })
    }

    fn plant_filter(&self) -> Option<FaultFilter<RotorSpeeds>> {
        FaultFilter::new(&self.messages, Port::PlantRotorSpeeds)
    }

    /// Continues a flight that had no message and stage faults, between two ticks.
    fn take_over(&mut self, rig: &Simulator) {
        let Some(tick) = rig.tick.checked_sub(1) else {
            return;
        };
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

    /// Messages rejected after a fault, except those to the plant.
    fn rejections(&self) -> Rejections {
        self.rejections
            .and(&self.outer_state.rejections())
            .and(&self.inner_state.rejections())
            .and(&self.inner_setpoint.rejections())
            .and(&self.mixer_wrench.rejections())
    }

    fn tick(&mut self, rig: &mut Simulator) {
        let tick = rig.tick;
        self.replace_killed(tick, rig);
        // A plant that is stopped until the end flies the last tick after its time.
        let plant_works = self.works(Role::Plant, tick) || tick == self.last_tick;
        if plant_works {
            self.plant(tick, rig);
        }
        if self.works(Role::Outer, tick) {
            self.outer_state.settle(tick);
            let state = self.outer_state.stamped();
            let late = self.lateness(Role::Outer, tick);
            if rig.outer.tick_into(tick, &state, &mut rig.setpoint.content) {
                rig.setpoint.tick = tick;
                self.inner_setpoint
                    .arrive_late(&message(&rig.setpoint), late.output);
            }
        }
        if self.works(Role::Inner, tick) {
            self.inner(tick, rig);
        }
        if self.works(Role::Mixer, tick) {
            self.mixer_wrench.settle(tick);
            let wrench = self.mixer_wrench.stamped();
            rig.mixer
                .tick_into(tick, &wrench, &mut rig.rotor_speeds.content);
            rig.rotor_speeds.tick = tick;
            rig.theorem.command(tick, &rig.rotor_speeds.content);
            let late = self.lateness(Role::Mixer, tick);
            if self.commands.len() == self.port_depth {
                self.commands.pop_front();
            }
            let acts_from = tick + 1 + late.output;
            self.commands.push_back((rig.rotor_speeds, acts_from));
        }
        rig.tick += 1;
    }

    fn offer(&mut self, plant: &mut Plant) {
        while let Some((command, acts_from)) = self.commands.pop_front() {
            plant.offer(&command, acts_from);
        }
    }

    /// The plant takes the commands that have arrived and publishes the state.
    fn plant(&mut self, tick: u64, rig: &mut Simulator) {
        self.offer(&mut rig.plant);
        rig.plant.begin_into(tick, &mut rig.state.content);
        rig.state.tick = tick;
        rig.envelope = rig.plant.envelope();
        let late = self.lateness(Role::Plant, tick);
        let state = message(&rig.state);
        self.outer_state.arrive_late(&state, late.output);
        self.inner_state.arrive_late(&state, late.output);
        if rig.theorem.applies() {
            if self.states.len() == KEPT {
                self.states.pop_front();
            }
            self.states.push_back(rig.state);
        }
    }

    fn inner(&mut self, tick: u64, rig: &mut Simulator) {
        self.inner_state.settle(tick);
        self.inner_setpoint.settle(tick);
        let (state, setpoint) = (self.inner_state.stamped(), self.inner_setpoint.stamped());
        rig.inner
            .tick_into(tick, &state, &setpoint, &mut rig.wrench.content);
        rig.wrench.tick = tick;
        let late = self.lateness(Role::Inner, tick);
        self.mixer_wrench
            .arrive_late(&message(&rig.wrench), late.output);
        if rig.theorem.applies() {
            while self
                .states
                .front()
                .is_some_and(|first| state.tick != NO_TICK && first.tick <= state.tick)
            {
                self.used = self.states.pop_front().unwrap_or(self.used);
            }
            // With the faults of the inner loop's input: their origin does not matter to the verdict.
            let mut input = self.used;
            if input.tick == state.tick {
                input.content.measured = state.content.measured;
            }
            rig.watch(&input, &setpoint);
        }
    }

    /// Installs the replacements due at this tick, with empty inputs. They continue from the state of those that were
    /// killed, or from the initial one if their law cannot be saved.
    fn replace_killed(&mut self, tick: u64, rig: &mut Simulator) {
        let mut saved = SavedState::new();
        let is_due = |(from, _): &mut (u64, Replacement)| *from == tick;
        for (_, replacement) in self.replacements.extract_if(.., is_due) {
            let messages = &self.messages;
            let counted = match replacement {
                Replacement::Outer(outer) => {
                    rig.outer.replace_by(outer, &mut saved);
                    let unused = FaultyInput::new(messages, Port::OuterState);
                    replace(&mut self.outer_state, unused).rejections()
                }
                Replacement::Inner(inner) => {
                    if !rig.inner.replace_by(inner, &mut saved) {
                        rig.theorem.begin();
                    }
                    let unused = FaultyInput::new(messages, Port::InnerState);
                    let states = replace(&mut self.inner_state, unused).rejections();
                    let unused = FaultyInput::new(messages, Port::InnerSetpoint);
                    states.and(&replace(&mut self.inner_setpoint, unused).rejections())
                }
                Replacement::Mixer(mixer) => {
                    rig.mixer.replace_by(mixer, &mut saved);
                    let unused = FaultyInput::new(messages, Port::MixerWrench);
                    replace(&mut self.mixer_wrench, unused).rejections()
                }
            };
            self.rejections = self.rejections.and(&counted);
        }
    }

    fn works(&self, role: Role, tick: u64) -> bool {
        let is_out = |fault: &StageFault| {
            fault.role == role
                && fault.span.contains(tick)
                && !matches!(fault.ticks, StageTicks::Late(_))
        };
        self.next_tick[role as usize] <= tick && !self.stages.iter().any(is_out)
    }

    /// How late the output and the next tick of a stage are.
    fn lateness(&mut self, role: Role, tick: u64) -> Lateness {
        let is_active = |fault: &&StageFault| fault.role == role && fault.span.contains(tick);
        let late = self
            .stages
            .iter()
            .find(is_active)
            .and_then(|fault| fault.lateness(self.messages.seed, tick))
            .unwrap_or(Lateness::NONE);
        self.next_tick[role as usize] = tick + late.next;
        late
    }
}

/// The message that a process would have sent.
fn message<C: Topic>(stamped: &Stamped<C>) -> Message<C> {
    Message::of_tick(stamped.tick, stamped.content)
}
