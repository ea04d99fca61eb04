//! The predictor: attitude and rates one tick ahead, when the torque will act.
//!
//! It is not in the paper, whose loop has no delay. The paper's gains need it: at alpha T = 10 the tick between sample
//! and actuation uses up the whole margin of the rate loop, and one late command makes it unstable
//! ([`crate::settings::loop_gain_limit`]). The predictor gives that tick back. It starts from the command that the
//! state message reports as in force, so its one-tick prediction is right even when a command was late. A predictor
//! that looks further than the delay is worse than none (docs/paper.md).

use messages::frames::RollPitch;
use messages::rate_dynamics::Inertia;
use nalgebra::Vector3;

use crate::rate_law::RatePoint;

/// (eta2 [rad], nu2 [rad/s]) one period later, by (8) and (5) with the estimates.
///
/// `now.om` and `tau` [N m] belong to the rotor command that is in force over this period; `theta` are the
/// estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
pub fn predict(
    eta2: &Vector3<f64>,
    now: &RatePoint,
    theta: &Vector3<f64>,
    tau: &Vector3<f64>,
    period_s: f64,
    inertia: &Inertia,
) -> (Vector3<f64>, Vector3<f64>) {
    let phi = inertia.regressor(&now.nu2, now.om, &now.h);
    let dnu2 = inertia.coupling(&now.nu2) + phi * theta + inertia.acceleration(tau);
    let nu2_next = now.nu2 + period_s * dnu2;
    let mean_nu2 = (now.nu2 + nu2_next) / 2.0;
    let eta2_next = eta2 + period_s * RollPitch::of(eta2).euler_rate(&mean_nu2);
    (eta2_next, nu2_next)
}
