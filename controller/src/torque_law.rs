//! From attitude setpoint, measurement and estimates to a torque: attitude loop, predictor and (19).
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (17)-(19), with the differences that [`crate::attitude_loop`] and [`crate::rate_law`] list. The adaptive law flies with
//! it, and the theorem's monitor compares every wrench with it.

use control_api::law::Rig;
use messages::allocation::net_speed;
use messages::content::Measured;
use messages::rate_dynamics::Inertia;
use nalgebra::Vector3;

use crate::adaptation::Evidence;
use crate::attitude_loop::AttitudeLoop;
use crate::gains::Gains;
use crate::rate_law::{RatePoint, predict, sampled_gain, torque};

/// Attitude loop, predictor and (19) with fixed gains; the estimates come from outside.
#[derive(Clone, Debug)]
pub struct TorqueLaw {
    pub attitude: AttitudeLoop,
    inertia: Inertia,
    period_s: f64,
    gain: f64,
    predicts: bool,
}

impl TorqueLaw {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        Self {
            attitude: AttitudeLoop::new(rig, gains),
            inertia: Inertia::new(rig.airframe.i_m().into()),
            period_s: rig.period_s,
            gain: sampled_gain(gains.alpha_1_s, rig.period_s),
            predicts: gains.predictor_ticks != 0.0,
        }
    }

    /// Torque [N m] and rate error e [rad/s] of the tick that the attitude loop has begun. `evidence` has taken the
    /// measurement of this tick, `theta` are the
    /// estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2], and `residual` is what else is to be cancelled [rad/s^2].
    pub fn torque(
        &self,
        tick: u64,
        measured: &Measured,
        theta: &Vector3<f64>,
        residual: &Vector3<f64>,
        evidence: &mut Evidence,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let samples = evidence.samples();
        let eta2 = Vector3::from(measured.attitude_rad);
        let now = RatePoint {
            nu2: measured.rate_b_rad_s.into(),
            om: net_speed(&measured.rotor_speed_mean_rad_s.into()),
            h: samples.newest_h(),
        };
        let (at, reference) = if self.predicts {
            let command = measured.rotor_speed_command_rad_s;
            let om_s = net_speed(&command.into());
            let tau_s = samples.rotor_torque(&command.map(|w| w * w));
            let now = RatePoint { om: om_s, ..now };
            let (eta2, nu2) = predict(&eta2, &now, theta, &tau_s, self.period_s, &self.inertia);
            let h = evidence.h(tick + 1);
            let reference = self.attitude.reference_ahead(&eta2, &nu2);
            (RatePoint { nu2, h, ..now }, reference)
        } else {
            (now, self.attitude.reference(&eta2, &now.nu2))
        };
        let tau = torque(&at, &reference, theta, self.gain, &self.inertia);
        let cancelled = self.inertia.i_m().component_mul(residual);
        (tau - cancelled, at.nu2 - reference.nu2_d)
    }
}
