//! Prints the hash over all outputs of one flight, as `ironbird simulate` prints it of the same flight.
//!
//! It consists of the laws alone, so that it is soon compiled for another processor. Every function of `messages::math` is
//! in the flight: motor lag, noise, limits, a fast reference. `.ci/same-bits` compares.

use control_api::description::Settings;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{INNER, OUTER};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{NO_TICK, Setpoint, Stamped};
use messages::output_hash::OutputHash;
use messages::parameters::Parameter;
use plant::{Plant, PlantSettings, Swap};

const LAST_TICK: u64 = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (rig, defaults) = (Rig::default(), Settings::default());
    let Rig {
        period_s,
        airframe,
        rotor,
    } = rig;
    let mut plant = Plant::new(&PlantSettings {
        period_s,
        airframe,
        rotor,
        seed: 1,
        ..PlantSettings::default()
    });
    plant.schedule(Swap::new(
        1000,
        &[
            (Parameter::MotorTimeConstant, 0.02),
            (Parameter::GyroNoise, 0.01),
        ],
    )?)?;
    plant.schedule(Swap::new(4000, &[(Parameter::RotationalDrag, 0.525)])?)?;
    let route = ScaledTrajectory::of(Trajectory::Fast).route(period_s);
    let mut outer = GuardedOuter::new(OUTER[0].make(&rig, &defaults)?, route, &rig);
    let mut inner = GuardedInner::new(INNER[0].make(&rig, &defaults)?, &rig);
    let mut mixer = GuardedMixer::new(mixer::LAWS[0].make(&rig, &defaults)?, &rig);

    let mut outputs = OutputHash::default();
    let mut setpoint = Stamped {
        tick: NO_TICK,
        content: Setpoint::default(),
    };
    for tick in 0..=LAST_TICK {
        let state = Stamped {
            tick,
            content: plant.begin(tick),
        };
        outputs.take(tick, &state.content);
        if let Some(content) = outer.tick(tick, &state) {
            setpoint = Stamped { tick, content };
            outputs.take(tick, &content);
        }
        let wrench = Stamped {
            tick,
            content: inner.tick(tick, &state, &setpoint),
        };
        let speeds = mixer.tick(tick, &wrench);
        outputs.take(tick, &wrench.content);
        outputs.take(tick, &speeds);
        plant.offer(
            &Stamped {
                tick,
                content: speeds,
            },
            tick + 1,
        );
        plant.finish();
    }
    println!("{outputs}");
    Ok(())
}
