//! The ground: whether there is one, and what is a crash.

use std::f64::consts::PI;

use plant::{Ground, Plant};
use serde::{Deserialize, Serialize};

use super::{Settings, within};
use failure::Failure;

/// The ground, at `flight.ground_z_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundSection {
    /// What the ground does.
    pub contact: ContactName,
    /// From the plane of the rotors to the feet, and to the top [m].
    pub leg_m: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Fastest touch that is a landing [m/s].
    pub crash_speed_m_s: f64,
    /// Largest tilt in a touch that is a landing [rad].
    pub crash_tilt_rad: f64,
}

/// What the ground does to the airframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ContactName {
    /// Nothing: the airframe falls on, and the report says that it was below ground.
    Off,
    /// It carries the airframe.
    Plane,
}

impl GroundSection {
    /// The plane at `z_m` [m], where there is one.
    #[must_use]
    pub fn plane(&self, z_m: f64) -> Option<Ground> {
        let &Self { contact, leg_m, friction, crash_speed_m_s, crash_tilt_rad } = self;
        let plane = Ground { z_m, leg_m, friction, crash_speed_m_s, crash_tilt_rad };
        (contact == ContactName::Plane).then_some(plane)
    }

    /// Refuses what is no ground.
    ///
    /// # Errors
    /// A usage [`Failure`] names the key, the value and what is allowed.
    pub(super) fn check(&self) -> Result<(), Failure> {
        within("ground.leg_m", self.leg_m, 0.001, 2.0)?;
        within("ground.friction", self.friction, 0.0, 2.0)?;
        within("ground.crash_speed_m_s", self.crash_speed_m_s, 0.0, 100.0)?;
        within("ground.crash_tilt_rad", self.crash_tilt_rad, 0.0, PI)
    }
}

impl Settings {
    /// Refuses a flight that begins in the ground.
    ///
    /// # Errors
    /// A usage [`Failure`] says how deep.
    pub(super) fn check_start(&self) -> Result<(), Failure> {
        // What rounding leaves of a start on the ground.
        const ROUNDING_M: f64 = 1e-9;
        let clearance_m = Plant::new(&self.plant()?).clearance_m();
        match clearance_m.filter(|clearance_m| *clearance_m < -ROUNDING_M) {
            Some(clearance_m) => Err(Failure::usage(format!(
                "initial.position_w_m[2] = {} is {:.3} m too low: the airframe would begin in the ground at {} m",
                self.initial.position_w_m[2], -clearance_m, self.flight.ground_z_m
            ))
            .help("begin higher, or set ground.contact = \"off\"")),
            None => Ok(()),
        }
    }
}
