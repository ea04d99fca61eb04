//! Prints the hash over all outputs of one flight, as `ironbird simulate` prints it of the same flight.
//!
//! It consists of the laws alone, so that it is soon compiled for another processor. Every function of `messages::math` is
//! in the flight: motor lag, noise, limits, a fast reference. `.ci/same-bits` compares.

use control_api::description::Settings;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{INNER, OUTER};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::output_hash::OutputHash;
use messages::parameters::Parameter::{GyroNoise, MotorTimeConstant, RotationalDrag};
use plant::{Plant, PlantSettings, Swap};

const LAST_TICK: u64 = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (rig, defaults) = (Rig::default(), Settings::default());
    let mut plant = Plant::new(&PlantSettings {
        period_s: rig.period_s,
        airframe: rig.airframe,
        rotor: rig.rotor,
        seed: 1,
        ..PlantSettings::default()
    });
    let slow_and_noisy = [(MotorTimeConstant, 0.02), (GyroNoise, 0.01)];
    plant.schedule(Swap::new(1000, &slow_and_noisy)?)?;
    plant.schedule(Swap::new(4000, &[(RotationalDrag, 0.525)])?)?;
    let route = ScaledTrajectory::of(Trajectory::Fast).route(rig.period_s);
    let mut outer = GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig);
    let mut inner = GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig);
    let mut mixer = GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig);
    let mut state = Stamped::<State>::never();
    let mut setpoint = Stamped::<Setpoint>::never();
    let mut wrench = Stamped::<Wrench>::never();
    let mut speeds = Stamped::<RotorSpeeds>::never();
    let mut outputs = OutputHash::default();
    for tick in 0..=LAST_TICK {
        plant.begin_into(tick, &mut state.content);
        state.tick = tick;
        outputs.take(tick, &state.content);
        if outer.tick_into(tick, &state, &mut setpoint.content) {
            setpoint.tick = tick;
            outputs.take(tick, &setpoint.content);
        }
        inner.tick_into(tick, &state, &setpoint, &mut wrench.content);
        wrench.tick = tick;
        outputs.take(tick, &wrench.content);
        mixer.tick_into(tick, &wrench, &mut speeds.content);
        speeds.tick = tick;
        outputs.take(tick, &speeds.content);
        plant.offer(&speeds, tick + 1);
        plant.finish();
    }
    println!("{outputs}");
    Ok(())
}
