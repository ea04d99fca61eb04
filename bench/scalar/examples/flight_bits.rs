//! Prints the hash over all outputs of one flight, as `ironbird simulate` prints it of the same flight.
//!
//! It consists of the laws alone, so that it is soon compiled for another processor. Every function of `model::math` is
//! in the flight: motor lag, noise, limits, a fast reference. `.ci/same-bits` compares.

use controller::laws::{INNER, OUTER};
use controller::{Course, Trajectory};
use law::description::Settings;
use law::stage::{InnerStage as _, MixerStage as _, OuterStage as _};
use law::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use model::messages::{Dated, NO_TICK, Setpoint};
use model::output_hash::OutputHash;
use model::parameters::Parameter;
use plant::{Plant, PlantSettings, Swap};

/// `--duration 10s`.
const LAST_TICK: u64 = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (rig, defaults) = (Rig::default(), Settings::default());
    let Rig { period_s, airframe, rotor } = rig;
    let mut plant = Plant::new(&PlantSettings { period_s, airframe, rotor, seed: 1, ..PlantSettings::default() });
    plant.schedule(Swap::new(1000, &[(Parameter::MotorTimeConstant, 0.02), (Parameter::GyroNoise, 0.01)])?)?;
    plant.schedule(Swap::new(4000, &[(Parameter::RotationalDrag, 0.525)])?)?;
    let route = Course::of(Trajectory::Fast).route(period_s);
    let mut outer = GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig);
    let mut inner = GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig);
    let mut mixer = GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig);

    let mut outputs = OutputHash::default();
    let mut setpoint = Dated { tick: NO_TICK, content: Setpoint::default() };
    for tick in 0..=LAST_TICK {
        let state = Dated { tick, content: plant.begin(tick) };
        outputs.take(tick, &state.content);
        if let Some(content) = outer.tick(tick, &state) {
            setpoint = Dated { tick, content };
            outputs.take(tick, &content);
        }
        let wrench = Dated { tick, content: inner.tick(tick, &state, &setpoint) };
        let speeds = mixer.tick(tick, &wrench);
        outputs.take(tick, &wrench.content);
        outputs.take(tick, &speeds);
        plant.offer(&Dated { tick, content: speeds }, tick + 1);
        plant.finish();
    }
    println!("{outputs}");
    Ok(())
}
