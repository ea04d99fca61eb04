//! What a plant is made of: airframe, start of the flight, envelope.

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

use messages::limits::RotorLimits;
use messages::parameters::Airframe;

use crate::ground::Ground;
use crate::integrator::SUBSTEPS;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantSettings {
    pub period_s: f64,
    /// Runge-Kutta steps per tick.
    pub substeps: u32,
    /// True parameters at the start; swaps change them in flight.
    pub airframe: Airframe,
    /// Range of the rotor speeds, whose lower end is idle.
    pub rotor: RotorLimits,
    pub seed: u64,
    /// Where the flight begins, and how the body moves there.
    pub initial: Initial,
    /// The ground; without one the airframe falls on.
    pub ground: Option<Ground>,
    /// Angle between body z and the vertical beyond which the flight has left its envelope [rad]; pi is no limit.
    pub tilt_max_rad: f64,
    /// Whether a ground station flies it: see [`crate::guidance`].
    pub follows_targets: bool,
}

impl Default for PlantSettings {
    /// The nominal airframe at 1 kHz, at rest in the origin, free to take any attitude.
    fn default() -> Self {
        Self {
            period_s: 0.001,
            substeps: SUBSTEPS,
            airframe: Airframe::nominal(),
            rotor: RotorLimits::default(),
            seed: 0,
            initial: Initial::default(),
            ground: None,
            tilt_max_rad: PI,
            follows_targets: false,
        }
    }
}

/// The body at tick 0; by default at rest in the origin, level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Initial {
    pub position_w_m: [f64; 3],
    pub velocity_w_m_s: [f64; 3],
    pub attitude_rad: [f64; 3],
    pub rate_b_rad_s: [f64; 3],
}
