//! The rig's own laws without the monitor: reference for the hand-written flight.
//!
//! `ironbird simulate` also runs the theorem's monitor, which no autopilot has.

use controller::{InnerLoop, OuterLoop, Preset, Trajectory};
use law::{InnerLaw as _, MixerLaw as _, OuterLaw as _};
use mixer::Mixer;
use model::limits::RotorLimits;
use model::messages::{Dated, NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use model::parameters::Airframe;
use plant::Plant;

/// Plant, outer loop, inner loop and mixer of the flight by hand, standing between two ticks.
#[derive(Clone, Debug)]
pub struct Laws {
    plant: Plant,
    outer: OuterLoop,
    inner: InnerLoop,
    mixer: Mixer,
    setpoint: Dated<Setpoint>,
    tick: u64,
}

impl Laws {
    /// The Lissajous figure with the gains `flight`, nominal airframe, 1 kHz, before tick 0.
    #[must_use]
    pub fn new() -> Self {
        let controller = controller::LoopSettings::new(Trajectory::Lissajous, Preset::Flight);
        let (period_s, airframe, rotor) = (controller.period_s, Airframe::nominal(), RotorLimits::default());
        Self {
            plant: Plant::new(&plant::PlantSettings { period_s, airframe, rotor, seed: 0 }),
            outer: OuterLoop::new(&controller),
            inner: InnerLoop::new(&controller),
            mixer: Mixer::new(&mixer::MixerSettings { period_s, model: airframe, rotor }),
            setpoint: Dated { tick: NO_TICK, content: Setpoint::default() },
            tick: 0,
        }
    }

    /// Flies one tick: state, what the inner loop asks for, and the command that is in force from the next tick on.
    pub fn tick(&mut self) -> (State, Wrench, RotorSpeeds) {
        let tick = self.tick;
        let state = Dated { tick, content: self.plant.begin(tick) };
        if let Some(content) = self.outer.tick(tick, &state) {
            self.setpoint = Dated { tick, content };
        }
        let wrench = self.inner.tick(tick, &state, &self.setpoint);
        let speeds = self.mixer.tick(tick, &Dated { tick, content: wrench });
        self.plant.offer(Dated { tick, content: speeds }, tick + 1);
        self.plant.finish();
        self.tick += 1;
        (state.content, wrench, speeds)
    }
}

impl Default for Laws {
    fn default() -> Self {
        Self::new()
    }
}
