//! The rig's own laws without the monitor: reference for the hand-written flight.
//!
//! `ironbird simulate` also runs the theorem's monitor beside them, which no autopilot has.

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
    state: Dated<State>,
    setpoint: Dated<Setpoint>,
    wrench: Dated<Wrench>,
    speeds: RotorSpeeds,
    tick: u64,
}

impl Laws {
    /// The Lissajous figure with the gains `flight`, nominal airframe, 1 kHz, before tick 0.
    #[must_use]
    pub fn new() -> Self {
        let controller = controller::LoopSettings::new(Trajectory::Lissajous, Preset::Flight);
        let (period_s, airframe, rotor) = (controller.period_s, Airframe::nominal(), RotorLimits::default());
        Self {
            plant: Plant::new(&plant::PlantSettings {
                period_s,
                airframe,
                rotor,
                seed: 0,
                ..plant::PlantSettings::default()
            }),
            outer: OuterLoop::new(&controller),
            inner: InnerLoop::new(&controller),
            mixer: Mixer::new(&mixer::MixerSettings { period_s, model: airframe, rotor }),
            state: Dated { tick: NO_TICK, content: State::default() },
            setpoint: Dated { tick: NO_TICK, content: Setpoint::default() },
            wrench: Dated { tick: NO_TICK, content: Wrench::default() },
            speeds: RotorSpeeds::default(),
            tick: 0,
        }
    }

    /// Flies one tick.
    pub fn tick(&mut self) {
        let tick = self.tick;
        let state = Dated { tick, content: self.plant.begin(tick) };
        if let Some(content) = self.outer.tick(tick, &state) {
            self.setpoint = Dated { tick, content };
        }
        self.wrench = Dated { tick, content: self.inner.tick(tick, &state, &self.setpoint) };
        self.speeds = self.mixer.tick(tick, &self.wrench);
        self.plant.offer(Dated { tick, content: self.speeds }, tick + 1);
        self.plant.finish();
        self.state = state;
        self.tick += 1;
    }

    /// State of the tick that was flown last, what the inner loop asked for, and the command that is in force from the
    /// next tick on.
    #[must_use]
    pub const fn newest(&self) -> (&State, &Wrench, &RotorSpeeds) {
        (&self.state.content, &self.wrench.content, &self.speeds)
    }
}

impl Default for Laws {
    fn default() -> Self {
        Self::new()
    }
}
