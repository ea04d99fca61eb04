//! Terms of the rotational dynamics (8): f, and the regressor Phi = [g1 g2 h].
//!
//! `d(nu2) = f + Phi theta + I_M^-1 tau` with the unknown theta = (I_R, k_r, delta). The plant integrates it with the
//! true parameters; the inner loop uses it as its model. Errata: f is a vector, row 3 of g2 is r/I_z (docs/paper.md).

use nalgebra::{Matrix3, Vector3};

use crate::math::{sin, sin_cos};
use crate::vectors::numbers;

/// I_M, with the quotients that (8) is made of: they change with the parameters alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertia {
    i_m: Vector3<f64>,
    inverse: Vector3<f64>,
    /// (I_z - I_y)/I_x, (I_x - I_z)/I_y, (I_y - I_x)/I_z.
    ratio: Vector3<f64>,
}

numbers!(Inertia: i_m, inverse, ratio);

impl Inertia {
    /// Of the diagonal of I_M [kg m^2].
    #[inline]
    pub fn new(i_m: Vector3<f64>) -> Self {
        let ratio = Vector3::new(
            (i_m.z - i_m.y) / i_m.x,
            (i_m.x - i_m.z) / i_m.y,
            (i_m.y - i_m.x) / i_m.z,
        );
        Self {
            i_m,
            inverse: i_m.map(f64::recip),
            ratio,
        }
    }

    /// The diagonal of I_M [kg m^2].
    #[inline]
    pub const fn i_m(&self) -> &Vector3<f64> {
        &self.i_m
    }

    /// f: inertial coupling of the body rates [rad/s^2].
    #[inline]
    pub fn coupling(&self, nu2: &Vector3<f64>) -> Vector3<f64> {
        let (p, q, r) = (nu2.x, nu2.y, nu2.z);
        Vector3::new(
            -self.ratio.x * q * r,
            -self.ratio.y * p * r,
            -self.ratio.z * p * q,
        )
    }

    /// Phi(nu2, Om, t) = [g1 g2 h]: columns for I_R [kg m^2], k_r [N m s], delta [rad/s^2]; `h` is h(t).
    ///
    /// It is linear in (nu2, h): at the mean of two samples it is the mean of both.
    #[rustfmt::skip]
    #[inline]
    pub fn regressor(&self, nu2: &Vector3<f64>, om: f64, h: &Vector3<f64>) -> Matrix3<f64> {
        let per_inertia = nu2.component_mul(&self.inverse);
        Matrix3::new(
            -om * nu2.y * self.inverse.x, -per_inertia.x, h.x,
            om * nu2.x * self.inverse.y,  -per_inertia.y, h.y,
            0.0,                          -per_inertia.z, h.z,
        )
    }

    /// I_M^-1 tau: what a torque [N m] adds to d(nu2) [rad/s^2].
    #[inline]
    pub fn acceleration(&self, tau: &Vector3<f64>) -> Vector3<f64> {
        tau.component_mul(&self.inverse)
    }
}

/// h(t): direction of the periodic disturbance, without unit.
#[inline]
pub fn disturbance(t_s: f64) -> Vector3<f64> {
    along_h(sin(t_s))
}

#[inline]
fn along_h(sin_t: f64) -> Vector3<f64> {
    Vector3::new(sin_t, 0.8 * sin_t, 0.6 * sin_t)
}

/// h(t) at instants that follow each other evenly: sin(t + dt) = sin t cos dt + cos t sin dt.
#[derive(Clone, Copy, Debug)]
pub struct Disturbances {
    /// Sine and cosine of the present instant.
    now: (f64, f64),
    step: (f64, f64),
}

impl Disturbances {
    /// From `t_s` [s] on, with sine and cosine of the time from one instant to the next.
    #[inline]
    pub fn new(t_s: f64, step: (f64, f64)) -> Self {
        Self {
            now: sin_cos(t_s),
            step,
        }
    }

    /// h at the next instant; at first, at the one that it begins with.
    #[inline]
    pub fn next_h(&mut self) -> Vector3<f64> {
        let ((sin, cos), (step_sin, step_cos)) = (self.now, self.step);
        self.now = (
            sin * step_cos + cos * step_sin,
            cos * step_cos - sin * step_sin,
        );
        along_h(sin)
    }
}
