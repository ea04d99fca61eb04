//! Prints the hash over all outputs of one flight, as `ironbird simulate` prints it of the same flight.
//!
//! It consists of the laws alone, so that it is soon compiled for another processor. Every function of `messages::math` is
//! in the flight: motor lag, noise, limits, a fast reference. `.ci/same-bits` compares.

use controller::Trajectory;
use messages::output_hash::OutputHash;
use messages::parameters::Parameter::{GyroNoise, MotorTimeConstant, RotationalDrag};
use plant::Swap;
use scalar::laws::Laws;

const LAST_TICK: u64 = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut laws = Laws::new(Trajectory::Fast, 1)?;
    let slow_and_noisy = [(MotorTimeConstant, 0.02), (GyroNoise, 0.01)];
    laws.plant.schedule(Swap::new(1000, &slow_and_noisy)?)?;
    laws.plant
        .schedule(Swap::new(4000, &[(RotationalDrag, 0.525)])?)?;
    let mut outputs = OutputHash::default();
    for tick in 0..=LAST_TICK {
        laws.tick();
        outputs.take(tick, &laws.state.content);
        if laws.setpoint.tick == tick {
            outputs.take(tick, &laws.setpoint.content);
        }
        outputs.take(tick, &laws.wrench.content);
        outputs.take(tick, &laws.speeds.content);
    }
    println!("{outputs}");
    Ok(())
}
