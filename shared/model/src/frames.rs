//! Rotations between the world, the body and the Euler-angle rates; ZYX convention.
//!
//! World frame: z up. Body frame: x forward, y left, z up. `eta2` is (phi, theta, psi) = (roll, pitch, yaw) in radians.
//! Paper: (2) and (5), with the errata of docs/paper.md (printed rows 2 and 3 of J2 are wrong).

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};

use crate::math::sin_cos;

/// J1: rotates a vector from the body into the world frame, `v_w = rot_wb * v_b`.
#[must_use]
#[rustfmt::skip]
#[inline]
pub fn rot_wb(eta2: &Vector3<f64>) -> Matrix3<f64> {
    let (s_phi, c_phi) = sin_cos(eta2.x);
    let (s_th, c_th) = sin_cos(eta2.y);
    let (s_psi, c_psi) = sin_cos(eta2.z);
    Matrix3::new(
        c_psi * c_th, c_psi * s_th * s_phi - s_psi * c_phi, c_psi * s_th * c_phi + s_psi * s_phi,
        s_psi * c_th, s_psi * s_th * s_phi + c_psi * c_phi, s_psi * s_th * c_phi - c_psi * s_phi,
        -s_th,        c_th * s_phi,                         c_th * c_phi,
    )
}

/// The same rotation as a unit quaternion x, y, z, w.
#[must_use]
#[inline]
pub fn quaternion_wb(eta2: &Vector3<f64>) -> [f64; 4] {
    let [(s_phi, c_phi), (s_th, c_th), (s_psi, c_psi)] = [eta2.x, eta2.y, eta2.z].map(|angle| sin_cos(angle / 2.0));
    [
        s_phi * c_th * c_psi - c_phi * s_th * s_psi,
        c_phi * s_th * c_psi + s_phi * c_th * s_psi,
        c_phi * c_th * s_psi - s_phi * s_th * c_psi,
        c_phi * c_th * c_psi + s_phi * s_th * s_psi,
    ]
}

/// J2: turns body rates into Euler-angle rates, `d(eta2) = J2 nu2`. Singular at a pitch of +-90 degrees.
#[must_use]
#[rustfmt::skip]
#[inline]
pub fn euler_rate_of_body_rate(eta2: &Vector3<f64>) -> Matrix3<f64> {
    let (s_phi, c_phi) = sin_cos(eta2.x);
    let (s_th, c_th) = sin_cos(eta2.y);
    let sec_th = c_th.recip();
    let t_th = s_th * sec_th;
    Matrix3::new(
        1.0, s_phi * t_th,   c_phi * t_th,
        0.0, c_phi,          -s_phi,
        0.0, s_phi * sec_th, c_phi * sec_th,
    )
}

/// W: turns Euler-angle rates into body rates, the inverse of J2.
#[must_use]
#[rustfmt::skip]
#[inline]
pub fn body_rate_of_euler_rate(eta2: &Vector3<f64>) -> Matrix3<f64> {
    let (s_phi, c_phi) = sin_cos(eta2.x);
    let (s_th, c_th) = sin_cos(eta2.y);
    Matrix3::new(
        1.0, 0.0,    -s_th,
        0.0, c_phi,  s_phi * c_th,
        0.0, -s_phi, c_phi * c_th,
    )
}

/// dW/dt at the Euler angles `eta2` and their rates `d_eta2`.
#[must_use]
#[rustfmt::skip]
#[inline]
pub fn body_rate_of_euler_rate_dot(eta2: &Vector3<f64>, d_eta2: &Vector3<f64>) -> Matrix3<f64> {
    let (s_phi, c_phi) = sin_cos(eta2.x);
    let (s_th, c_th) = sin_cos(eta2.y);
    let (d_phi, d_th) = (d_eta2.x, d_eta2.y);
    Matrix3::new(
        0.0, 0.0,            -c_th * d_th,
        0.0, -s_phi * d_phi, c_phi * c_th * d_phi - s_phi * s_th * d_th,
        0.0, -c_phi * d_phi, -s_phi * c_th * d_phi - c_phi * s_th * d_th,
    )
}

/// Brings an angle into [-pi, pi).
#[must_use]
#[inline]
pub fn wrap(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    // rem_euclid may round up to the modulus itself for tiny negative arguments.
    if wrapped >= PI { -PI } else { wrapped }
}
