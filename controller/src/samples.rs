//! Whole ticks as they were measured: the input of the adaptation.
//!
//! The paper has no counterpart, since nothing is sampled in continuous time. A tick counts only if both its start and
//! its end were measured, because the rotor means of a state cover one tick.

use control_api::law::Rig;
use messages::allocation::{Allocation, net_speed};
use messages::content::{Measured, ROTORS};
use messages::rate_dynamics::disturbance;
use nalgebra::Vector3;

/// One whole tick as it was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LastTick {
    /// nu2 at its start [rad/s].
    pub nu2_start: Vector3<f64>,
    /// nu2 at its end [rad/s].
    pub nu2_end: Vector3<f64>,
    /// h(t) at its start, without unit.
    pub h_start: Vector3<f64>,
    /// h(t) at its end, without unit.
    pub h_end: Vector3<f64>,
    /// Om_m, mean net rotor speed [rad/s].
    pub om_m: f64,
    /// tau_m, mean torque of the rotors by the nominal model [N m].
    pub tau_m: Vector3<f64>,
}

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
    h: Vector3<f64>,
}

impl Samples {
    pub fn new(rig: &Rig) -> Self {
        Self {
            period_s: rig.period_s,
            allocation: Allocation::new(&rig.airframe),
            k: rig.airframe.k(),
            newest: None,
        }
    }

    pub fn newest_tick(&self) -> Option<u64> {
        self.newest.map(|newest| newest.tick)
    }

    /// h(t) at the newest sample, without unit; 0 before the first.
    pub fn newest_h(&self) -> Vector3<f64> {
        self.newest.map_or(Vector3::zeros(), |newest| newest.h)
    }

    /// Takes the measurement of `tick`; gives the tick that ended with it, unless its start was not measured.
    pub fn take(&mut self, tick: u64, measured: &Measured) -> Option<LastTick> {
        let end = Sample {
            tick,
            nu2: measured.rate_b_rad_s.into(),
            h: disturbance(tick as f64 * self.period_s),
        };
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
    pub fn rotor_torque(&self, speed_squared: &[f64; ROTORS]) -> Vector3<f64> {
        let f = speed_squared.map(|w2| self.k * w2);
        self.allocation.wrench(&f.into()).1
    }
}
