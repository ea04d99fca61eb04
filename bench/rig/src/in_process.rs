//! A flight in one process: the four tick functions, called in the order of the data.
//!
//! plant -> outer -> inner -> mixer -> plant. There is no transport, clock or deadline, so every command is in time.
//! Four processes that miss no deadline must reproduce this flight bit by bit. It is also the fast one for tests and
//! campaigns. It allocates nothing after [`InProcess::new`].

use controller::{OuterLoop, WatchedLoop};
use mixer::Mixer;
use model::messages::{Dated, NO_TICK, Setpoint};
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
    inner: WatchedLoop,
    mixer: Mixer,
    /// The newest one, as the inner loop would hold it.
    setpoint: Dated<Setpoint>,
    /// Tick that is next.
    tick: u64,
    envelope: Result<(), Departure>,
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
            inner: WatchedLoop::new(controller),
            mixer: Mixer::new(mixer),
            setpoint: Dated { tick: NO_TICK, content: Setpoint::default() },
            tick: 0,
            envelope: Ok(()),
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

    /// Flies one tick.
    pub fn tick(&mut self) -> TickRecord {
        let tick = self.tick;
        let state = Dated { tick, content: self.plant.begin(tick) };
        self.envelope = self.plant.envelope();
        let setpoint = self.outer.tick(tick, &state);
        if let Some(content) = setpoint {
            self.setpoint = Dated { tick, content };
        }
        let wrench = self.inner.tick(tick, &state, &self.setpoint);
        let rotor_speeds = self.mixer.tick(tick, &Dated { tick, content: wrench });
        self.plant.offer(Dated { tick, content: rotor_speeds }, tick + 1);
        self.plant.finish();
        self.tick += 1;
        TickRecord { tick, state: state.content, setpoint, wrench, rotor_speeds }
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
