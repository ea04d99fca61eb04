//! A flight in one process: the four tick functions, called in the order of the data.
//!
//! plant -> outer -> inner -> mixer -> plant. There is no transport, clock or deadline, so every command is in time.
//! Four processes that miss no deadline must reproduce this flight bit by bit. It is also the fast one for tests and
//! campaigns. It allocates nothing after [`InProcess::new`].

use controller::{InnerLoop, OuterLoop, TheoremMonitor};
use mixer::Mixer;
use model::messages::{Dated, NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use plant::{Departure, Plant};

use crate::settings::Settings;
use failure::Failure;
use law::{InnerLaw as _, MixerLaw as _, OuterLaw as _};
use report::tick::TickRecord;

/// A flight in one process, standing between two ticks.
#[derive(Clone, Debug)]
pub struct InProcess {
    plant: Plant,
    outer: OuterLoop,
    inner: InnerLoop,
    mixer: Mixer,
    state: Dated<State>,
    /// The newest one, as the inner loop would hold it.
    setpoint: Dated<Setpoint>,
    wrench: Dated<Wrench>,
    rotor_speeds: RotorSpeeds,
    /// Tick that is next.
    tick: u64,
    envelope: Result<(), Departure>,
    /// Beside the laws, where somebody asks for it.
    theorem: Option<TheoremMonitor>,
    monitor: Option<Monitor>,
}

impl InProcess {
    /// A flight that is about to begin with tick 0.
    #[must_use]
    pub fn new(
        plant: &plant::PlantSettings,
        controller: &controller::LoopSettings,
        mixer: &mixer::MixerSettings,
    ) -> Self {
        Self {
            plant: Plant::new(plant),
            outer: OuterLoop::new(controller),
            inner: InnerLoop::new(controller),
            mixer: Mixer::new(mixer),
            state: Dated { tick: NO_TICK, content: State::default() },
            setpoint: Dated { tick: NO_TICK, content: Setpoint::default() },
            wrench: Dated { tick: NO_TICK, content: Wrench::default() },
            rotor_speeds: RotorSpeeds::default(),
            tick: 0,
            envelope: Ok(()),
            theorem: None,
            monitor: None,
        }
    }

    /// The flight that settings describe, with its faults scheduled.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn of(settings: &Settings) -> Result<Self, Failure> {
        let mut rig = Self::new(&settings.plant()?, &settings.controller()?, &settings.mixer()?);
        for fault in settings.faults()? {
            rig.plant.schedule(fault).map_err(|e| Failure::usage(format!("fault: {e}")))?;
        }
        Ok(rig)
    }

    /// The same flight with the theorem's monitor beside it, for a controller with these settings.
    #[must_use]
    pub fn watched(self, controller: &controller::LoopSettings) -> Self {
        Self { theorem: Some(TheoremMonitor::new(controller)), ..self }
    }

    /// Flies one tick.
    pub fn tick(&mut self) {
        let tick = self.tick;
        self.state = Dated { tick, content: self.plant.begin(tick) };
        self.envelope = self.plant.envelope();
        if let Some(content) = self.outer.tick(tick, &self.state) {
            self.setpoint = Dated { tick, content };
        }
        self.wrench = Dated { tick, content: self.inner.tick(tick, &self.state, &self.setpoint) };
        self.rotor_speeds = self.mixer.tick(tick, &self.wrench);
        self.plant.offer(Dated { tick, content: self.rotor_speeds }, tick + 1);
        self.plant.finish();
        if let Some(theorem) = &mut self.theorem {
            self.monitor = Some(*theorem.watch(tick, &self.state, &self.wrench.content));
        }
        self.tick += 1;
    }

    /// State of the tick that was flown last.
    #[must_use]
    pub const fn state(&self) -> &State {
        &self.state.content
    }

    /// Its set-point, if the outer loop gave one.
    #[must_use]
    pub fn setpoint(&self) -> Option<&Setpoint> {
        (self.setpoint.tick == self.state.tick).then_some(&self.setpoint.content)
    }

    /// Its wrench.
    #[must_use]
    pub const fn wrench(&self) -> &Wrench {
        &self.wrench.content
    }

    /// Its rotor command, which is in force from the next tick on.
    #[must_use]
    pub const fn rotor_speeds(&self) -> &RotorSpeeds {
        &self.rotor_speeds
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
            rotor_speeds: self.rotor_speeds,
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
