//! From thrust and attitude to stick positions.

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

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    const SCALE: StickScale = StickScale {
        angle_rad: 1.0,
        yaw_rad_s: 4.0,
        yaw_gain_1_s: 2.0,
        idle: 0.1,
        full_thrust_n: 16.0,
    };

    fn sticks(thrust_n: f64, attitude_rad: [f64; 3], yaw_rad: f64, yaw_rate_rad_s: f64) -> Sticks {
        let wanted = Desired {
            thrust_n,
            attitude_rad,
            attitude_rate_rad_s: [0.0; 3],
            attitude_acceleration_rad_s2: [0.0; 3],
            limited: 0,
        };
        SCALE.sticks(&wanted, yaw_rad, yaw_rate_rad_s)
    }

    #[test]
    fn sticks_have_the_signs_of_a_pilot() {
        // Thrust [N], attitude [rad], yaw and yaw rate; then roll, pitch, yaw and throttle.
        for (thrust_n, attitude_rad, yaw_rad, yaw_rate_rad_s, expected) in [
            // Body x forward, y left, z up: a positive roll is to the right, a positive pitch forward, a positive yaw to the left.
            (4.0, [0.0; 3], 0.0, 0.0, [0.0, 0.0, 0.0, 0.4 / 0.9]),
            (4.0, [0.2, 0.0, 0.0], 0.0, 0.0, [0.2, 0.0, 0.0, 0.4 / 0.9]),
            (4.0, [0.0, 0.3, 0.0], 0.0, 0.0, [0.0, 0.3, 0.0, 0.4 / 0.9]),
            // A rate of 1 and an error of 0.5 to the left turn the stick to the left.
            (4.0, [0.0, 0.0, 0.7], 0.2, 1.0, [0.0, 0.0, -0.5, 0.4 / 0.9]),
            // Neither thrust nor tilt is beyond full deflection.
            (99.0, [1.5, 0.0, 0.0], 0.0, 0.0, [1.0, 0.0, 0.0, 1.0]),
            (-1.0, [0.0; 3], 0.0, 0.0, [0.0; 4]),
        ] {
            let found = sticks(thrust_n, attitude_rad, yaw_rad, yaw_rate_rad_s);
            let found = [found.roll, found.pitch, found.yaw, found.throttle];
            let differs = |(a, b): (&f64, f64)| (a - b).abs() > 1e-12;
            assert!(
                !found.iter().zip(expected).any(differs),
                "{found:?}, not {expected:?}"
            );
        }
        // The other way around from the measured heading, forward is backward.
        let turned = sticks(4.0, [0.0, 0.3, 3.0], 3.0 - PI, 0.0);
        assert!((turned.pitch + 0.3).abs() < 1e-12, "{turned:?}");
    }
}
