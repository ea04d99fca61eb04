//! From a thrust acceleration to the attitude that gives it, with two derivatives.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (13)-(16). Differences from the paper: (13) and (14) are arcsines of a component *divided by* the norm, written with
//! atan2. As printed, multiplied by the norm, they have no value above 0.10 m/s^2. The derivatives are not in the
//! paper, which feeds none forward; they follow from (13) and (14) along the reference.

use model::math::{atan2, hypot, sin_cos};
use nalgebra::Vector3;

/// Yaw along the reference: psi_d [rad], dpsi_d [rad/s], ddpsi_d [rad/s^2].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Yaw {
    /// psi_d [rad].
    pub psi: f64,
    /// dpsi_d [rad/s].
    pub dpsi: f64,
    /// ddpsi_d [rad/s^2].
    pub ddpsi: f64,
}

/// Derivatives of roll and pitch along the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TiltRates {
    /// dphi_d [rad/s].
    pub dphi: f64,
    /// dtheta_d [rad/s].
    pub dtheta: f64,
    /// ddphi_d [rad/s^2].
    pub ddphi: f64,
    /// ddtheta_d [rad/s^2].
    pub ddtheta: f64,
}

/// (13), (14): roll and pitch [rad] that point the thrust along `a` [m/s^2, world frame] at yaw `psi` [rad].
///
/// `a` is the acceleration that the thrust gives, gravity and drag included; its z must be above 0.
#[must_use]
pub fn tilt(a: &Vector3<f64>, psi: f64) -> (f64, f64) {
    let (sin, cos) = sin_cos(psi);
    let s = a.x * sin - a.y * cos;
    let c = a.x * cos + a.y * sin;
    (atan2(s, hypot(c, a.z)), atan2(c, a.z))
}

/// First and second derivatives of [`tilt`] where `a` [m/s^2] changes by `da` [m/s^3] and `dda` [m/s^4].
#[must_use]
pub fn tilt_rates(a: &Vector3<f64>, da: &Vector3<f64>, dda: &Vector3<f64>, yaw: &Yaw) -> TiltRates {
    let &Yaw { psi, dpsi, ddpsi } = yaw;
    let (sin, cos) = sin_cos(psi);
    let across = |v: &Vector3<f64>| v.x * sin - v.y * cos;
    let along = |v: &Vector3<f64>| v.x * cos + v.y * sin;
    let (s, c) = (across(a), along(a));
    let ds = across(da) + dpsi * c;
    let dc = along(da) - dpsi * s;
    let dds = across(dda) + dpsi * along(da) + ddpsi * c + dpsi * dc;
    let ddc = along(dda) - dpsi * across(da) - ddpsi * s - dpsi * ds;

    let q = c * c + a.z * a.z;
    let dq = 2.0 * (c * dc + a.z * da.z);
    let ddq = 2.0 * (dc * dc + c * ddc + da.z * da.z + a.z * dda.z);
    let rho = q.sqrt();
    let drho = dq / (2.0 * rho);
    let ddrho = ddq / (2.0 * rho) - dq * dq / (4.0 * rho * q);
    let n = s * s + q;

    let dtheta = (dc * a.z - c * da.z) / q;
    let dphi = (ds * rho - s * drho) / n;
    TiltRates {
        dphi,
        dtheta,
        ddphi: (dds * rho - s * ddrho) / n - dphi * 2.0 * (s * ds + rho * drho) / n,
        ddtheta: (ddc * a.z - c * dda.z) / q - dtheta * dq / q,
    }
}
