//! The rate law: torque that decays the rate error and cancels what was learnt.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri), (19)
//! on (8). Differences from the paper: d(nu2_d) stands inside I_M(...), as (8) demands, and the error is called e
//! throughout. The gain is alpha in continuous time but [`sampled_gain`] here: with alpha itself, the paper's 1e4/s
//! would multiply the error by 1 - alpha T = -9 in every tick of 1 ms.
//!
//! The paper uses nu2_d and d(nu2_d) in (17)-(19) but does not derive them from the eta2_d of (13), (14). Here xi, the
//! wanted Euler rates, closes the attitude error with K_eta, and (5) turns xi into body rates ([`rate_reference`]).
//!
//! The predictor ([`predict`]) is not in the paper, whose loop has no delay. The paper's gains need it: at alpha T = 10 the
//! tick between sample and actuation uses up the whole margin of the rate loop, and one late command makes it unstable
//! ([`crate::rate_loop::loop_gain_limit`]). The predictor gives that tick back. It starts from the command that the state
//! message reports as in force, so its one-tick prediction is right even when a command was late. A predictor that looks
//! further than the delay is worse than none (docs/paper.md).

use messages::attitude::Attitude;
use messages::frames::{RollPitch, wrap};
use messages::math::exp_m1;
use messages::rate_dynamics::Inertia;
use nalgebra::Vector3;

use crate::command_filter::CommandFilter;
use crate::laws::cascade::DesiredAttitude;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateReference {
    /// nu2_d, body frame [rad/s].
    pub nu2_d: Vector3<f64>,
    /// d(nu2_d), body frame [rad/s^2].
    pub dnu2_d: Vector3<f64>,
}

/// nu2_d = W xi and its derivative, at attitude `eta2` [rad] and body rates `nu2` [rad/s].
///
/// `e2` is the filter's second derivative [rad/s^2], `k_eta` the attitude gain per axis [1/s]. The yaw error is
/// wrapped, so that the airframe turns the short way. Singular at a pitch of +-90 degrees.
pub fn rate_reference(
    eta2: &Vector3<f64>,
    nu2: &Vector3<f64>,
    filter: &CommandFilter,
    e2: &Vector3<f64>,
    k_eta: &Vector3<f64>,
) -> RateReference {
    let CommandFilter { ec, e1, .. } = filter;
    let roll_pitch = RollPitch::of(eta2);
    let d_eta2 = roll_pitch.euler_rate(nu2);
    let mut error = ec - eta2;
    error.z = wrap(error.z);
    let xi = e1 + k_eta.component_mul(&error);
    let dxi = e2 + k_eta.component_mul(&(e1 - d_eta2));
    RateReference {
        nu2_d: roll_pitch.body_rate(&xi),
        dnu2_d: roll_pitch.body_rate(&dxi) + roll_pitch.body_rate_dot(&d_eta2, &xi),
    }
}

/// The same, where K_eta closes the rotation q_e = q^-1 q_d between attitude and filtered attitude instead of the
/// difference of their Euler angles. The paper has no counterpart.
///
/// ```text
///     nu2_d = K_eta 2 vec(q_e) + R_e w_d,   w_d = W e1 at the filtered attitude,   w_e = R_e w_d - nu2
///     dnu2_d = K_eta (scalar(q_e) w_e + w_e x vec(q_e)) + R_e dw_d - nu2 x R_e w_d
/// ```
///
/// Where yaw is off, the difference of the Euler angles asks for the roll and the pitch that point the thrust as wanted
/// at the *wanted* yaw; the rotation asks for those that do so at the yaw that is.
pub fn quaternion_reference(
    eta2: &Vector3<f64>,
    nu2: &Vector3<f64>,
    filter: &CommandFilter,
    e2: &Vector3<f64>,
    k_eta: &Vector3<f64>,
) -> RateReference {
    let desired = DesiredAttitude::at(&filter.ec, &filter.e1, e2);
    let q_e = Attitude::of_euler(eta2)
        .inverse()
        .times(&desired.attitude)
        .short_way();
    let (w_d, dw_d) = (q_e.to_world(&desired.nu2), q_e.to_world(&desired.dnu2));
    let (w_e, vector) = (w_d - nu2, q_e.vector());
    let d_error = q_e.scalar() * w_e + w_e.cross(&vector);
    RateReference {
        nu2_d: 2.0 * k_eta.component_mul(&vector) + w_d,
        dnu2_d: k_eta.component_mul(&d_error) + dw_d - nu2.cross(&w_d),
    }
}

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
