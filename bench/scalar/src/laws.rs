//! The rig's own laws without the monitor: reference for the hand-written flight.
//!
//! `ironbird simulate` also runs the theorem's monitor beside them, which no autopilot has.

use control_api::description::{Refused, Settings};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{INNER, OUTER};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use plant::{Plant, PlantSettings};

/// Plant, outer loop, inner loop and mixer with the gains `flight`, standing between two ticks, and what the stages put
/// out last.
pub struct Laws {
    pub plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    mixer: GuardedMixer,
    pub state: Stamped<State>,
    pub setpoint: Stamped<Setpoint>,
    pub wrench: Stamped<Wrench>,
    pub speeds: Stamped<RotorSpeeds>,
    tick: u64,
}

impl Laws {
    /// A trajectory with the nominal airframe at 1 kHz, before tick 0.
    pub fn new(trajectory: Trajectory, seed: u64) -> Result<Self, Refused> {
        let (rig, defaults) = (Rig::default(), Settings::default());
        let route = ScaledTrajectory::of(trajectory).route(rig.period_s);
        let settings = PlantSettings {
            period_s: rig.period_s,
            airframe: rig.airframe,
            rotor: rig.rotor,
            seed,
            ..PlantSettings::default()
        };
        Ok(Self {
            plant: Plant::new(&settings),
            outer: GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig),
            inner: GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig),
            mixer: GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig),
            state: Stamped::never(),
            setpoint: Stamped::never(),
            wrench: Stamped::never(),
            speeds: Stamped::never(),
            tick: 0,
        })
    }

    pub fn tick(&mut self) {
        let tick = self.tick;
        self.plant.begin_into(tick, &mut self.state.content);
        self.state.tick = tick;
        let setpoint = &mut self.setpoint;
        if self
            .outer
            .tick_into(tick, &self.state, &mut setpoint.content)
        {
            setpoint.tick = tick;
        }
        let wrench = &mut self.wrench.content;
        self.inner
            .tick_into(tick, &self.state, &self.setpoint, wrench);
        self.wrench.tick = tick;
        self.mixer
            .tick_into(tick, &self.wrench, &mut self.speeds.content);
        self.speeds.tick = tick;
        self.plant.offer(&self.speeds, tick + 1);
        self.plant.finish();
        self.tick += 1;
    }
}
