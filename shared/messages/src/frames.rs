//! Rotations between the world, the body and the Euler-angle rates; ZYX convention.
//!
//! World frame: z up. Body frame: x forward, y left, z up. `eta2` is (phi, theta, psi) = (roll, pitch, yaw) in radians.
//! Paper: (2) and (5), with the errata of docs/paper.md (printed rows 2 and 3 of J2 are wrong).

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};

use crate::math::sin_cos;

/// Roll and pitch by their sines and cosines, from which every matrix of an attitude is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollPitch([f64; 4]);

impl RollPitch {
    /// Those of the Euler angles `eta2` [rad].
    #[inline]
    pub fn of(eta2: &Vector3<f64>) -> Self {
        let (s_phi, c_phi) = sin_cos(eta2.x);
        let (s_th, c_th) = sin_cos(eta2.y);
        Self([s_phi, c_phi, s_th, c_th])
    }

    /// J1: rotates a vector from the body into the world frame, `v_w = rot_wb * v_b`, at yaw `psi` [rad].
    #[rustfmt::skip]
    #[inline]
    pub fn rot_wb(&self, psi: f64) -> Matrix3<f64> {
        let [s_phi, c_phi, s_th, c_th] = self.0;
        let (s_psi, c_psi) = sin_cos(psi);
        Matrix3::new(
            c_psi * c_th, c_psi * s_th * s_phi - s_psi * c_phi, c_psi * s_th * c_phi + s_psi * s_phi,
            s_psi * c_th, s_psi * s_th * s_phi + c_psi * c_phi, s_psi * s_th * c_phi - c_psi * s_phi,
            -s_th,        c_th * s_phi,                         c_th * c_phi,
        )
    }

    /// J2 `nu2`: the Euler-angle rates d(eta2) of body rates. Singular at a pitch of +-90 degrees.
    ///
    /// ```text
    ///     J2 = [ 1  sin(phi)tan(theta)  cos(phi)tan(theta) ; 0  cos(phi)  -sin(phi) ;
    ///            0  sin(phi)/cos(theta)  cos(phi)/cos(theta) ]
    /// ```
    #[inline]
    pub fn euler_rate(&self, nu2: &Vector3<f64>) -> Vector3<f64> {
        let [s_phi, c_phi, s_th, c_th] = self.0;
        let d_psi = (s_phi * nu2.y + c_phi * nu2.z) / c_th;
        Vector3::new(nu2.x + s_th * d_psi, c_phi * nu2.y - s_phi * nu2.z, d_psi)
    }

    /// W `xi`: the body rates of Euler-angle rates, the inverse of J2.
    ///
    /// ```text
    ///     W = [ 1  0  -sin(theta) ; 0  cos(phi)  sin(phi)cos(theta) ; 0  -sin(phi)  cos(phi)cos(theta) ]
    /// ```
    #[inline]
    pub fn body_rate(&self, xi: &Vector3<f64>) -> Vector3<f64> {
        let [s_phi, c_phi, s_th, c_th] = self.0;
        let across = c_th * xi.z;
        Vector3::new(
            xi.x - s_th * xi.z,
            c_phi * xi.y + s_phi * across,
            c_phi * across - s_phi * xi.y,
        )
    }

    /// d(W)/dt `xi`, while the Euler angles change by `d_eta2` [rad/s].
    ///
    /// ```text
    ///     dW/dt = [ 0  0  -c_th dth ; 0  -s_phi dphi  c_phi c_th dphi - s_phi s_th dth ;
    ///               0  -c_phi dphi  -s_phi c_th dphi - c_phi s_th dth ]
    /// ```
    #[inline]
    pub fn body_rate_dot(&self, d_eta2: &Vector3<f64>, xi: &Vector3<f64>) -> Vector3<f64> {
        let [s_phi, c_phi, s_th, c_th] = self.0;
        let (across, d_across) = (c_th * xi.z, -s_th * d_eta2.y * xi.z);
        let (d_phi, d_th) = (d_eta2.x, d_eta2.y);
        Vector3::new(
            -c_th * d_th * xi.z,
            d_phi * (c_phi * across - s_phi * xi.y) + s_phi * d_across,
            -d_phi * (s_phi * across + c_phi * xi.y) + c_phi * d_across,
        )
    }
}

/// The same rotation as a unit quaternion x, y, z, w.
#[inline]
pub fn quaternion_wb(eta2: &Vector3<f64>) -> [f64; 4] {
    let [(s_phi, c_phi), (s_th, c_th), (s_psi, c_psi)] =
        [eta2.x, eta2.y, eta2.z].map(|angle| sin_cos(angle / 2.0));
    [
        s_phi * c_th * c_psi - c_phi * s_th * s_psi,
        c_phi * s_th * c_psi + s_phi * c_th * s_psi,
        c_phi * c_th * s_psi - s_phi * s_th * c_psi,
        c_phi * c_th * c_psi + s_phi * s_th * s_psi,
    ]
}

/// Brings an angle into [-pi, pi).
#[inline]
pub fn wrap(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    // rem_euclid may round up to the modulus itself for tiny negative arguments.
    if wrapped >= PI { -PI } else { wrapped }
}
