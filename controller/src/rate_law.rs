//! The rate law: torque that decays the rate error and cancels what was learnt.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri), (19)
//! on (8). Differences from the paper: d(nu2_d) stands inside I_M(...), as (8) demands, and the error is called e
//! throughout. The gain is alpha in continuous time but [`sampled_gain`] here: with alpha itself, the paper's 1e4/s
//! would multiply the error by 1 - alpha T = -9 in every tick of 1 ms.

use messages::math::exp_m1;
use messages::rate_dynamics::Inertia;
use nalgebra::Vector3;

use crate::rate_reference::RateReference;

/// Arguments of the rate dynamics (8) at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatePoint {
    /// nu2, body rates [rad/s].
    pub nu2: Vector3<f64>,
    /// Om, net rotor speed (4) [rad/s].
    pub om: f64,
    /// h(t), direction of the disturbance, without unit.
    pub h: Vector3<f64>,
}

/// a_d = (1 - exp(-alpha T))/T [1/s]: the gain for which a torque held over T gives e(t + T) = exp(-alpha T) e(t).
pub fn sampled_gain(alpha_1_s: f64, period_s: f64) -> f64 {
    -exp_m1(-alpha_1_s * period_s) / period_s
}

/// (19): torque tau [N m, body frame] for d(e) = -`gain` e, e = nu2 - nu2_d.
///
/// `theta` are the estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2]; `gain` [1/s] is [`sampled_gain`], or alpha
/// itself for the law in continuous time.
pub fn torque(
    at: &RatePoint,
    reference: &RateReference,
    theta: &Vector3<f64>,
    gain: f64,
    inertia: &Inertia,
) -> Vector3<f64> {
    let e = at.nu2 - reference.nu2_d;
    let known = inertia.coupling(&at.nu2);
    let learnt = inertia.regressor(&at.nu2, at.om, &at.h) * theta;
    inertia
        .i_m()
        .component_mul(&(reference.dnu2_d - gain * e - known - learnt))
}
