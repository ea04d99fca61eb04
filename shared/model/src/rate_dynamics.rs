//! Terms of the rotational dynamics (8): f, and the regressor Phi = [g1 g2 h].
//!
//! `d(nu2) = f + Phi theta + I_M^-1 tau` with the unknown theta = (I_R, k_r, delta). The plant integrates it with the
//! true parameters; the inner loop uses it as its model. Errata: f is a vector, row 3 of g2 is r/I_z (docs/paper.md).

use nalgebra::{Matrix3, Vector3};

use crate::math::sin;

/// f: inertial coupling of the body rates [rad/s^2]; `i_m` is the diagonal of I_M [kg m^2].
#[must_use]
#[inline]
pub fn coupling(nu2: &Vector3<f64>, i_m: &Vector3<f64>) -> Vector3<f64> {
    let (p, q, r) = (nu2.x, nu2.y, nu2.z);
    Vector3::new(-(i_m.z - i_m.y) / i_m.x * q * r, -(i_m.x - i_m.z) / i_m.y * p * r, -(i_m.y - i_m.x) / i_m.z * p * q)
}

/// h(t): direction of the periodic disturbance, without unit.
#[must_use]
#[inline]
pub fn disturbance(t_s: f64) -> Vector3<f64> {
    let s = sin(t_s);
    Vector3::new(s, 0.8 * s, 0.6 * s)
}

/// Phi(nu2, Om, t) = [g1 g2 h]: columns for I_R [kg m^2], k_r [N m s], delta [rad/s^2]; `h` is [`disturbance`] at t.
#[must_use]
#[rustfmt::skip]
#[inline]
pub fn regressor(nu2: &Vector3<f64>, om: f64, h: &Vector3<f64>, i_m: &Vector3<f64>) -> Matrix3<f64> {
    let (p, q, r) = (nu2.x, nu2.y, nu2.z);
    let inverse = i_m.map(f64::recip);
    Matrix3::new(
        -om * q * inverse.x, -p * inverse.x, h.x,
        om * p * inverse.y,  -q * inverse.y, h.y,
        0.0,                 -r * inverse.z, h.z,
    )
}
