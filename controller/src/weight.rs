//! W = I + X G X^T with a diagonal G: what a step of the estimates divides by, in factors.
//!
//! For the step of "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran,
//! Montazeri), (20), in discrete time, G is (T/alpha) Gamma. W is symmetric, and positive definite for every finite X.
//! Its factors are W = L D L^T, with ones on the diagonal of L: no root is taken.

use nalgebra::{Matrix3, Vector3};

use crate::samples::LastTick;

/// X and Y after a whole tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regression {
    pub x: Matrix3<f64>,
    /// Y, filtered sample of what the regressor must explain [rad/s^2].
    pub y: Vector3<f64>,
    /// W = I + (T/alpha) X Gamma X^T; none where it is no number.
    pub weight: Option<Weight>,
    pub last: LastTick,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    l10: f64,
    l20: f64,
    l21: f64,
    per_d: Vector3<f64>,
}

impl Weight {
    /// Of X and the diagonal of G; none where W is no number.
    #[inline]
    pub fn new(x: &Matrix3<f64>, g: &Vector3<f64>) -> Option<Self> {
        let row = |i: usize| Vector3::new(x[(i, 0)], x[(i, 1)], x[(i, 2)]);
        let [x0, x1, x2] = [row(0), row(1), row(2)];
        let [g0, g1, g2] = [x0, x1, x2].map(|row| row.component_mul(g));
        let d0 = 1.0 + x0.dot(&g0);
        let per_d0 = 1.0 / d0;
        let (w10, w20) = (x1.dot(&g0), x2.dot(&g0));
        let (l10, l20) = (w10 * per_d0, w20 * per_d0);
        let d1 = 1.0 + x1.dot(&g1) - l10 * w10;
        let per_d1 = 1.0 / d1;
        let w21 = x2.dot(&g1) - l20 * w10;
        let l21 = w21 * per_d1;
        let d2 = 1.0 + x2.dot(&g2) - l20 * w20 - l21 * w21;
        let is_positive = d0 > 0.0 && d1 > 0.0 && d2 > 0.0;
        is_positive.then(|| Self {
            l10,
            l20,
            l21,
            per_d: Vector3::new(per_d0, per_d1, 1.0 / d2),
        })
    }

    #[inline]
    pub fn solve(&self, r: &Vector3<f64>) -> Vector3<f64> {
        let &Self {
            l10,
            l20,
            l21,
            per_d,
        } = self;
        let f1 = r.y - l10 * r.x;
        let f2 = r.z - l20 * r.x - l21 * f1;
        let z2 = f2 * per_d.z;
        let z1 = f1 * per_d.y - l21 * z2;
        Vector3::new(r.x * per_d.x - l10 * z1 - l20 * z2, z1, z2)
    }

    /// S^T W^-1 S = (L^-1 S)^T D^-1 (L^-1 S).
    #[inline]
    pub fn sandwiched(&self, s: &Matrix3<f64>) -> Matrix3<f64> {
        let &Self {
            l10,
            l20,
            l21,
            per_d,
        } = self;
        let row = |i: usize| Vector3::new(s[(i, 0)], s[(i, 1)], s[(i, 2)]);
        let f0 = row(0);
        let f1 = row(1) - l10 * f0;
        let f2 = row(2) - l20 * f0 - l21 * f1;
        let [d0, d1, d2] = [f0 * per_d.x, f1 * per_d.y, f2 * per_d.z];
        let element = |i: usize, j: usize| f0[i] * d0[j] + f1[i] * d1[j] + f2[i] * d2[j];
        let (e01, e02, e12) = (element(0, 1), element(0, 2), element(1, 2));
        Matrix3::new(
            element(0, 0),
            e01,
            e02,
            e01,
            element(1, 1),
            e12,
            e02,
            e12,
            element(2, 2),
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::array::uniform9;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_divides_by_w(x in uniform9(-50.0..50.0), r in prop::array::uniform3(-10.0..10.0)) {
            let (x, r) = (Matrix3::from(x_rows(&x)), Vector3::from(r));
            let g = Vector3::new(1e-9, 3e-6, 5e-4);
            let w = Matrix3::identity() + x * Matrix3::from_diagonal(&g) * x.transpose();
            let weight = Weight::new(&x, &g).unwrap();
            prop_assert!((w * weight.solve(&r) - r).amax() < 1e-12 * r.amax().max(1.0));
            let sandwiched = x.transpose() * w.try_inverse().unwrap() * x;
            prop_assert!((weight.sandwiched(&x) - sandwiched).amax() < 1e-10 * sandwiched.amax().max(1.0));
        }
    }

    fn x_rows(x: &[f64; 9]) -> [[f64; 3]; 3] {
        [[x[0], x[1], x[2]], [x[3], x[4], x[5]], [x[6], x[7], x[8]]]
    }

    #[test]
    fn there_is_none_of_what_is_no_number() {
        let x = Matrix3::new(1.0, 0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(Weight::new(&x, &Vector3::repeat(1.0)), None);
    }
}
