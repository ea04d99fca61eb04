//! From thrust and attitude to stick positions.

use control_api::Rig;
use control_api::law::Desired;
use messages::attitude::Attitude;
use messages::frames::wrap;
use messages::math::atan2;
use nalgebra::Vector3;

/// Positions of the sticks: right, forward and clockwise are positive, from -1 to 1; throttle from 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    pub roll: f64,
    pub pitch: f64,
    pub yaw: f64,
    pub throttle: f64,
    /// Whether the switch is at "armed".
    pub armed: bool,
}

/// How the firmware takes its sticks.
#[derive(Clone, Copy, Debug)]
pub struct StickScale {
    /// Tilt at full deflection [rad].
    pub angle_rad: f64,
    /// Rate of yaw at full deflection [rad/s].
    pub yaw_rad_s: f64,
    /// From yaw error to rate [1/s].
    pub yaw_gain_1_s: f64,
    /// Motor command at throttle 0.
    pub idle: f64,
    /// Thrust of all rotors at motor command 1 [N].
    pub full_thrust_n: f64,
}

impl StickScale {
    pub fn full_thrust_n(rig: &Rig) -> f64 {
        4.0 * rig.rotor.f_max(rig.airframe.k())
    }

    /// The sticks that ask for a thrust and an attitude at the measured yaw [rad], with the yaw rate of the reference
    /// [rad/s].
    ///
    /// The tilt is that of the wanted thrust direction as seen from the measured heading, so that a yaw error does not
    /// turn it.
    pub fn sticks(&self, wanted: &Desired, yaw_rad: f64, yaw_rate_rad_s: f64) -> Sticks {
        let [roll, pitch, yaw] = wanted.attitude_rad;
        let yaw_error = wrap(yaw - yaw_rad);
        let z_b = Attitude::of_euler(&Vector3::new(roll, pitch, yaw_error)).z_b_in_w();
        let horizontal = (z_b.x * z_b.x + z_b.z * z_b.z).sqrt();
        let share = (wanted.thrust_n.max(0.0) / self.full_thrust_n).sqrt();
        let within = |share: f64, least: f64| share.clamp(least, 1.0);
        Sticks {
            roll: within(atan2(-z_b.y, horizontal) / self.angle_rad, -1.0),
            pitch: within(atan2(z_b.x, z_b.z) / self.angle_rad, -1.0),
            yaw: within(
                -(yaw_rate_rad_s + self.yaw_gain_1_s * yaw_error) / self.yaw_rad_s,
                -1.0,
            ),
            throttle: within((share - self.idle) / (1.0 - self.idle), 0.0),
            armed: true,
        }
    }
}
