//! A flight in one process: the four tick functions, called in the order of the data.
//!
//! plant -> outer -> inner -> mixer -> plant. There is no transport, clock or deadline, so every command is in time.
//! Four processes that miss no deadline must reproduce this flight bit by bit. It is also the fast one for tests and
//! campaigns. It allocates nothing after [`InProcess::new`].

mod faulted;
pub mod timed;

use controller::TheoremMonitor;
use model::fault::live::Trouble;
use model::inspection::Rejections;
use model::messages::{Dated, NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use model::reference::Reference;
use model::role::Role;
use plant::{Departure, Plant};

use self::faulted::Faulted;
use crate::fault::FaultError;
use crate::fault::plan::{StageFault, StageTicks};
use crate::settings::Settings;
use failure::Failure;
use law::stage::{InnerStage as _, MixerStage as _, OuterStage as _};
use law::{GuardedInner, GuardedMixer, GuardedOuter};
use report::states::Joined;
use report::tick::TickRecord;

/// A flight in one process, standing between two ticks.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct InProcess {
    plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    mixer: GuardedMixer,
    state: Dated<State>,
    /// The newest one, as the inner loop would hold it.
    setpoint: Dated<Setpoint>,
    wrench: Dated<Wrench>,
    rotor_speeds: Dated<RotorSpeeds>,
    /// Tick that is next.
    tick: u64,
    envelope: Result<(), Departure>,
    /// Beside the laws, where somebody asks for it.
    theorem: Option<TheoremMonitor>,
    monitor: Option<Monitor>,
    /// Faults of messages and stages; none where there are none, which is the fast way.
    faulted: Option<Box<Faulted>>,
}

fn needs_no_processor(what: &'static str) -> Failure {
    Failure::usage(format!("fault: {}", FaultError::Processor(what)))
}

impl InProcess {
    /// A flight that is about to begin with tick 0.
    #[must_use]
    pub fn new(plant: &plant::PlantSettings, outer: GuardedOuter, inner: GuardedInner, mixer: GuardedMixer) -> Self {
        Self {
            plant: Plant::new(plant),
            outer,
            inner,
            mixer,
            state: Dated { tick: NO_TICK, content: State::default() },
            setpoint: Dated { tick: NO_TICK, content: Setpoint::default() },
            wrench: Dated { tick: NO_TICK, content: Wrench::default() },
            rotor_speeds: Dated { tick: NO_TICK, content: RotorSpeeds::default() },
            tick: 0,
            envelope: Ok(()),
            theorem: None,
            monitor: None,
            faulted: None,
        }
    }

    /// The flight that settings describe, with its faults.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn of(settings: &Settings) -> Result<Self, Failure> {
        Self::faulty(settings, settings.outer_stage()?, settings.inner_stage()?)
    }

    /// The same with other loops than the settings name.
    ///
    /// # Errors
    /// As [`Self::of`]; usage where such a loop is to be killed: nobody knows how to make it anew.
    pub fn with(settings: &Settings, outer: GuardedOuter, inner: GuardedInner) -> Result<Self, Failure> {
        let is_lost = |fault: &&StageFault| fault.kind == StageTicks::Anew && fault.role != Role::Mixer;
        if let Some(fault) = settings.planned()?.stages.iter().find(is_lost) {
            return Err(Failure::usage(format!(
                "{}.kill: the law was handed over, and cannot be made anew",
                fault.role
            ))
            .help("stop the stage instead, or name a law that the settings can make"));
        }
        Self::faulty(settings, outer, inner)
    }

    fn faulty(settings: &Settings, outer: GuardedOuter, inner: GuardedInner) -> Result<Self, Failure> {
        let mixer = settings.mixer_stage()?;
        let mut rig = Self::new(&settings.plant()?, outer, inner, mixer);
        let planned = settings.planned()?;
        for fault in &planned.acts {
            match fault.trouble {
                Trouble::Hog { .. } => return Err(needs_no_processor("cpu.hog")),
                Trouble::Load { .. } => return Err(needs_no_processor("cpu.load")),
                _ => {}
            }
        }
        if !planned.spares_the_loop() {
            let faulted = Faulted::new(settings, &planned)?;
            rig.plant.gate(faulted.plant_gate());
            rig.faulted = Some(Box::new(faulted));
        }
        for swap in planned.swaps {
            rig.plant.schedule(swap).map_err(|e| Failure::usage(format!("fault: {e}")))?;
        }
        Ok(rig)
    }

    /// The same flight with the theorem's monitor beside it, where the inner law has a theorem.
    #[must_use]
    pub fn watched(self, theorem: Option<TheoremMonitor>) -> Self {
        let mut rig = Self { theorem, ..self };
        if let Some(faulted) = &mut rig.faulted {
            faulted.theorem.clone_from(&rig.theorem);
        }
        rig
    }

    /// The flight that this one would become under other settings, which differ in faults of messages and stages that
    /// begin later: 60 ticks, for those that look back. Nothing where a law cannot be copied.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn branch(&self, settings: &Settings) -> Result<Option<Box<Self>>, Failure> {
        let mut rig = Box::new(Self::of(settings)?);
        let Self { plant, outer, inner, mixer, .. } = self;
        if !(rig.outer.copy_from(outer) && rig.inner.copy_from(inner) && rig.mixer.copy_from(mixer)) {
            return Ok(None);
        }
        rig.plant.clone_from(plant);
        if let Some(faulted) = &mut rig.faulted {
            rig.plant.gate(faulted.plant_gate());
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

    /// Flies one tick.
    pub fn tick(&mut self) {
        if self.faulted.is_some() {
            self.faulty_tick();
            return;
        }
        self.stages(None);
        self.plant.finish();
    }

    /// Flies a tick but for its end, at which the plant is to finish: plants of several flights do so abreast. Of a
    /// flight whose messages and stages have no faults; `reference` is that of the tick, where somebody knows it.
    pub(crate) fn stages(&mut self, reference: Option<Reference>) {
        let Self { plant, outer, inner, mixer, state, setpoint, wrench, rotor_speeds, tick, .. } = self;
        let tick = *tick;
        plant.begin_into(tick, &mut state.content);
        state.tick = tick;
        self.envelope = plant.envelope();
        let has_setpoint = match reference {
            Some(reference) => outer.tick_along(reference, tick, state, &mut setpoint.content),
            None => outer.tick_into(tick, state, &mut setpoint.content),
        };
        if has_setpoint {
            setpoint.tick = tick;
        }
        inner.tick_into(tick, state, setpoint, &mut wrench.content);
        wrench.tick = tick;
        mixer.tick_into(tick, wrench, &mut rotor_speeds.content);
        rotor_speeds.tick = tick;
        plant.offer(rotor_speeds, tick + 1);
        if let Some(theorem) = &mut self.theorem {
            self.monitor = Some(*theorem.watch(tick, state, &wrench.content));
        }
        self.tick += 1;
    }

    #[cold]
    fn faulty_tick(&mut self) {
        if let Some(mut faulted) = self.faulted.take() {
            faulted.tick(self);
            self.faulted = Some(faulted);
        }
    }

    /// Whether messages or stages have faults.
    pub(crate) const fn is_faulted(&self) -> bool {
        self.faulted.is_some()
    }

    /// Tick that was flown last; [`NO_TICK`] before the first.
    #[must_use]
    pub const fn flown_tick(&self) -> u64 {
        self.tick.wrapping_sub(1)
    }

    /// Tick that is next.
    #[must_use]
    pub const fn next_tick(&self) -> u64 {
        self.tick
    }

    /// Tick of the state that was published last.
    #[must_use]
    pub const fn state_tick(&self) -> u64 {
        self.state.tick
    }

    /// Whether the plant published a state in that tick: not where it is out.
    #[must_use]
    pub const fn has_state(&self) -> bool {
        self.state.tick == self.flown_tick()
    }

    /// Messages that inspection refused for what a fault had made of them.
    #[must_use]
    pub fn rejections(&self) -> Rejections {
        let of_stages = self.faulted.as_ref().map(|faulted| faulted.rejections()).unwrap_or_default();
        of_stages.and(&self.plant.rejections())
    }

    /// State of the tick that was flown last; an older one where the plant is out.
    #[must_use]
    pub const fn state(&self) -> &State {
        &self.state.content
    }

    /// Its set-point, if the outer loop gave one.
    #[must_use]
    pub fn setpoint(&self) -> Option<&Setpoint> {
        (self.setpoint.tick == self.flown_tick()).then_some(&self.setpoint.content)
    }

    /// Its wrench; the last one where the inner loop is out.
    #[must_use]
    pub const fn wrench(&self) -> &Wrench {
        &self.wrench.content
    }

    /// Its rotor command, which is in force from the next tick on; the last one where the mixer is out.
    #[must_use]
    pub const fn rotor_speeds(&self) -> &RotorSpeeds {
        &self.rotor_speeds.content
    }

    /// Its wrench, if the inner loop gave one.
    #[must_use]
    pub fn new_wrench(&self) -> Option<&Wrench> {
        (self.wrench.tick == self.flown_tick()).then_some(&self.wrench.content)
    }

    /// Its rotor command, if the mixer gave one.
    #[must_use]
    pub fn new_rotor_speeds(&self) -> Option<&RotorSpeeds> {
        (self.rotor_speeds.tick == self.flown_tick()).then_some(&self.rotor_speeds.content)
    }

    /// The state, with what the stages made of it.
    #[must_use]
    pub fn joined(&self) -> Joined {
        let wrench = self.new_wrench().copied();
        Joined {
            tick: self.flown_tick(),
            state: *self.state(),
            setpoint: self.setpoint().copied(),
            wrench,
            rotor_speeds: self.new_rotor_speeds().copied(),
            monitor: self.monitor.filter(|_| wrench.is_some()),
        }
    }

    /// What is said of the theorem, if it is watched.
    #[must_use]
    pub const fn monitor(&self) -> Option<&Monitor> {
        self.monitor.as_ref()
    }

    /// All of it.
    #[must_use]
    pub fn record(&self) -> TickRecord {
        TickRecord {
            tick: self.state.tick,
            state: *self.state(),
            setpoint: self.setpoint().copied(),
            wrench: *self.wrench(),
            rotor_speeds: *self.rotor_speeds(),
            monitor: self.monitor,
        }
    }

    /// Whether the model covers the state of the tick that was flown last, as the plant's process judges it.
    ///
    /// # Errors
    /// [`Departure`] says in what way it does not.
    pub const fn envelope(&self) -> Result<(), Departure> {
        self.envelope
    }

    /// The plant, to look at its parameters, applied swaps and envelope.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The plant, to schedule swaps before the flight and between its ticks.
    pub fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }
}
