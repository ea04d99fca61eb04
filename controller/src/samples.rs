//! Whole ticks as they were measured: the input of the adaptation.
//!
//! The paper has no counterpart, since nothing is sampled in continuous time. A tick counts only if both its start and
//! its end were measured, because the rotor means of a state cover one tick.

use law::law::Rig;
use model::allocation::{Allocation, net_speed};
use model::measured::Measured;
use model::messages::ROTORS;
use model::rate_dynamics::disturbance;
use nalgebra::Vector3;

use crate::adaptation::LastTick;

/// The newest measured body rates, and the nominal rotors between them and the ones before.
#[derive(Clone, Debug)]
pub struct Samples {
    period_s: f64,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    newest: Option<Sample>,
}

/// Body rates that were measured in time.
#[derive(Clone, Copy, Debug)]
struct Sample {
    tick: u64,
    nu2: Vector3<f64>,
    /// h(t) at the tick.
    h: Vector3<f64>,
}

impl Samples {
    /// Before the first sample.
    #[must_use]
    pub fn new(rig: &Rig) -> Self {
        Self { period_s: rig.period_s, allocation: Allocation::new(&rig.airframe), k: rig.airframe.k(), newest: None }
    }

    /// Tick of the newest sample.
    #[must_use]
    pub fn newest_tick(&self) -> Option<u64> {
        self.newest.map(|newest| newest.tick)
    }

    /// h(t) at the newest sample, without unit; 0 before the first.
    #[must_use]
    pub fn newest_h(&self) -> Vector3<f64> {
        self.newest.map_or(Vector3::zeros(), |newest| newest.h)
    }

    /// Takes the measurement of `tick`; gives the tick that ended with it, unless its start was not measured.
    pub fn take(&mut self, tick: u64, measured: &Measured) -> Option<LastTick> {
        let end = Sample { tick, nu2: measured.rate_b_rad_s.into(), h: disturbance(tick as f64 * self.period_s) };
        let start = self.newest.replace(end)?;
        (start.tick + 1 == tick).then(|| LastTick {
            nu2_start: start.nu2,
            nu2_end: end.nu2,
            h_start: start.h,
            h_end: end.h,
            om_m: net_speed(&measured.rotor_speed_mean_rad_s.into()),
            tau_m: self.rotor_torque(&measured.rotor_speed_squared_mean_rad2_s2),
        })
    }

    /// (6), (7): torque [N m] of rotors at these squared speeds [rad^2/s^2], by the nominal model.
    #[must_use]
    pub fn rotor_torque(&self, speed_squared: &[f64; ROTORS]) -> Vector3<f64> {
        let f = speed_squared.map(|w2| self.k * w2);
        self.allocation.wrench(&f.into()).1
    }
}
