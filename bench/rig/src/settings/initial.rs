//! Where the flight begins, and how the body moves there.

use std::f64::consts::{FRAC_PI_2, PI};

use plant::Initial;
use serde::{Deserialize, Serialize};

use super::within;
use failure::Failure;

/// The body at tick 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialSection {
    /// Position, world frame [m].
    pub position_w_m: [f64; 3],
    /// Velocity, world frame [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Roll, pitch, yaw [rad].
    pub attitude_rad: [f64; 3],
    /// Body rates p, q, r [rad/s].
    pub rate_b_rad_s: [f64; 3],
}

impl InitialSection {
    /// Refuses what is no place or motion of an airframe.
    ///
    /// # Errors
    /// A usage [`Failure`] names the key, the value and what is allowed.
    pub(super) fn check(&self) -> Result<(), Failure> {
        for (key, values, limits) in [
            ("position_w_m", self.position_w_m, [1e4; 3]),
            ("velocity_w_m_s", self.velocity_w_m_s, [100.0; 3]),
            ("attitude_rad", self.attitude_rad, [PI, FRAC_PI_2, PI]),
            ("rate_b_rad_s", self.rate_b_rad_s, [100.0; 3]),
        ] {
            for (i, (value, limit)) in values.into_iter().zip(limits).enumerate() {
                within(&format!("initial.{key}[{i}]"), value, -limit, limit)?;
            }
        }
        Ok(())
    }
}

impl From<&InitialSection> for Initial {
    fn from(section: &InitialSection) -> Self {
        let InitialSection { position_w_m, velocity_w_m_s, attitude_rad, rate_b_rad_s } = *section;
        Self { position_w_m, velocity_w_m_s, attitude_rad, rate_b_rad_s }
    }
}
