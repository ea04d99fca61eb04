//! What the sensors show at a tick: all that a law is ever told of the airframe.

use crate::layout::layout;
use crate::messages::ROTORS;

/// The airframe as its sensors show it at a tick, and what its rotors did since the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Measured {
    /// Position, world frame [m].
    pub position_w_m: [f64; 3],
    /// Velocity, world frame [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Roll, pitch, yaw: ZYX Euler angles, body to world [rad]. Yaw is continuous; singular at a pitch of +-90 degrees.
    pub attitude_rad: [f64; 3],
    /// The same attitude as a unit quaternion, body to world: w, x, y, z. Continuous in sign.
    pub attitude_quaternion: [f64; 4],
    /// Body rates p, q, r as the gyro measures them [rad/s].
    pub rate_b_rad_s: [f64; 3],
    /// Specific force as the accelerometer measures it, body frame: acceleration less gravity [m/s^2].
    pub specific_force_b_m_s2: [f64; 3],
    /// Mean of each rotor's speed over the last tick [rad/s].
    pub rotor_speed_mean_rad_s: [f64; ROTORS],
    /// Mean of each rotor's squared speed over the last tick [rad^2/s^2].
    pub rotor_speed_squared_mean_rad2_s2: [f64; ROTORS],
    /// Rotor speeds that are in force from this tick on [rad/s]; the motors get them after the delay of commands.
    pub rotor_speed_command_rad_s: [f64; ROTORS],
}

impl Default for Measured {
    /// At rest in the origin, level.
    fn default() -> Self {
        Self {
            position_w_m: [0.0; 3],
            velocity_w_m_s: [0.0; 3],
            attitude_rad: [0.0; 3],
            attitude_quaternion: [1.0, 0.0, 0.0, 0.0],
            rate_b_rad_s: [0.0; 3],
            specific_force_b_m_s2: [0.0; 3],
            rotor_speed_mean_rad_s: [0.0; ROTORS],
            rotor_speed_squared_mean_rad2_s2: [0.0; ROTORS],
            rotor_speed_command_rad_s: [0.0; ROTORS],
        }
    }
}

layout!(Measured {
    position_w_m,
    velocity_w_m_s,
    attitude_rad,
    attitude_quaternion,
    rate_b_rad_s,
    specific_force_b_m_s2,
    rotor_speed_mean_rad_s,
    rotor_speed_squared_mean_rad2_s2,
    rotor_speed_command_rad_s,
});
