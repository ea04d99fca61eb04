//! The rig's own laws without the monitor: reference for the hand-written flight.
//!
//! `ironbird simulate` also runs the theorem's monitor beside them, which no autopilot has.

use control_api::description::{Refused, Settings};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{INNER, OUTER};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use plant::{Plant, PlantSettings};

/// Plant, outer loop, inner loop and mixer of the flight by hand, standing between two ticks.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct Laws {
    plant: Plant,
    outer: GuardedOuter,
    inner: GuardedInner,
    mixer: GuardedMixer,
    state: Stamped<State>,
    setpoint: Stamped<Setpoint>,
    wrench: Stamped<Wrench>,
    speeds: Stamped<RotorSpeeds>,
    tick: u64,
}

impl Laws {
    /// The Lissajous figure with the gains `flight`, nominal airframe, 1 kHz, before tick 0.
    pub fn new() -> Result<Self, Refused> {
        let (rig, defaults) = (Rig::default(), Settings::default());
        let Rig {
            period_s,
            airframe,
            rotor,
        } = rig;
        let route = ScaledTrajectory::of(Trajectory::Lissajous).route(period_s);
        let settings = PlantSettings {
            period_s,
            airframe,
            rotor,
            ..PlantSettings::default()
        };
        Ok(Self {
            plant: Plant::new(&settings),
            outer: GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig),
            inner: GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig),
            mixer: GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig),
            state: Stamped {
                tick: NO_TICK,
                content: State::default(),
            },
            setpoint: Stamped {
                tick: NO_TICK,
                content: Setpoint::default(),
            },
            wrench: Stamped {
                tick: NO_TICK,
                content: Wrench::default(),
            },
            speeds: Stamped {
                tick: NO_TICK,
                content: RotorSpeeds::default(),
            },
            tick: 0,
        })
    }

    pub fn tick(&mut self) {
        let tick = self.tick;
        let Self {
            plant,
            outer,
            inner,
            mixer,
            state,
            setpoint,
            wrench,
            speeds,
            ..
        } = self;
        plant.begin_into(tick, &mut state.content);
        state.tick = tick;
        if outer.tick_into(tick, state, &mut setpoint.content) {
            setpoint.tick = tick;
        }
        inner.tick_into(tick, state, setpoint, &mut wrench.content);
        wrench.tick = tick;
        mixer.tick_into(tick, wrench, &mut speeds.content);
        speeds.tick = tick;
        plant.offer(speeds, tick + 1);
        plant.finish();
        self.tick += 1;
    }

    /// State of the tick that was flown last, what the inner loop asked for, and the command that is in force from the
    /// next tick on.
    #[must_use]
    pub const fn newest(&self) -> (&State, &Wrench, &RotorSpeeds) {
        (
            &self.state.content,
            &self.wrench.content,
            &self.speeds.content,
        )
    }
}
