//! From the filtered attitude to the body rates that follow it, with derivative.
//!
//! The paper ("An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle", Imran, Montazeri) uses
//! nu2_d and d(nu2_d) in (17)-(19) but does not derive them from the eta2_d of (13), (14). Here xi, the wanted Euler
//! rates, closes the attitude error with K_eta, and (5) turns xi into body rates.

use messages::frames::{RollPitch, wrap};
use nalgebra::Vector3;

use crate::command_filter::CommandFilter;

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
