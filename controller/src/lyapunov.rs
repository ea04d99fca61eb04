//! The theorem's functions in discrete time: V_th, V, and how a step lowers them.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri), (21)
//! and (22), sampled; docs/paper.md has the proofs. Let ~th = th_hat - th, s = T/alpha and W = I + s X Gamma X^T. Let
//! eps = Y - X th be the part of the sample that the true parameters leave unexplained. Then a step before its clip
//! obeys
//!
//! ```text
//!     zb = W^-1 (Y - X th_hat),    V_th+ - V_th = s eps.zb - s |zb|^2 - s^2/2 zb^T X Gamma X^T zb
//! ```
//!
//! for any eps. The theorem is the case eps = 0; in general the right side is at most s |eps|^2/4.

use messages::math::exp;
use nalgebra::{Matrix3, Vector3};

use crate::adaptation::{Adaptation, Weight};

/// V_th = 1/2 ~th^T Gamma^-1 ~th [rad^2/s^2], for `error` ~th and the diagonal `gamma`.
pub fn v_th(error: &Vector3<f64>, gamma: &Vector3<f64>) -> f64 {
    error.component_mul(error).component_div(gamma).sum() / 2.0
}

/// V_th after a step less V_th before it, without cancelling their common digits.
pub fn v_th_change(before: &Vector3<f64>, after: &Vector3<f64>, gamma: &Vector3<f64>) -> f64 {
    (after - before)
        .component_mul(&(after + before))
        .component_div(gamma)
        .sum()
        / 2.0
}

/// The weights of one step of the estimates, given the filtered regressor X.
#[derive(Clone, Debug)]
pub struct EstimateStep {
    /// s = T/alpha [s^2].
    step_s2: f64,
    scaled: Matrix3<f64>,
    /// W = I + s X Gamma X^T.
    weight: Weight,
}

impl EstimateStep {
    /// The step of an adaptation at X, with W of the same X.
    pub fn new(adaptation: &Adaptation, x: &Matrix3<f64>, weight: Weight) -> Self {
        let root = adaptation.gain().map(f64::sqrt);
        let scaled = Matrix3::from_fn(|i, j| x[(i, j)] * root[j]);
        Self {
            step_s2: adaptation.step_s2,
            scaled,
            weight,
        }
    }

    /// zb = W^-1 r [rad/s^2]: what a step leaves of the residual r.
    pub fn left_of(&self, r: &Vector3<f64>) -> Vector3<f64> {
        self.weight.solve(r)
    }

    /// s |zb|^2 + s^2/2 zb^T X Gamma X^T zb [rad^2/s^2]: the fall of V_th that the theorem promises.
    pub fn descent(&self, zb: &Vector3<f64>) -> f64 {
        self.step_s2 * (zb.norm_squared() + self.scaled.tr_mul(zb).norm_squared() / 2.0)
    }

    /// s eps.zb [rad^2/s^2]: what a model that leaves `mismatch` eps [rad/s^2] unexplained adds to the change of V_th.
    pub fn disturbance(&self, mismatch: &Vector3<f64>, zb: &Vector3<f64>) -> f64 {
        self.step_s2 * mismatch.dot(zb)
    }

    /// G = s Gamma^1/2 X^T W^-1 X Gamma^1/2: on the exact model a step multiplies Gamma^-1/2 ~th by I - G.
    pub fn contraction(&self) -> Matrix3<f64> {
        self.weight.sandwiched(&self.scaled)
    }

    /// Trace of s X Gamma X^T: no eigenvalue is above it.
    pub fn size(&self) -> f64 {
        self.scaled.norm_squared()
    }
}

/// The weight of |e|^2 in V = sigma/2 |e|^2 + V_th, as it follows from the largest step so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateWeight {
    /// a = exp(-alpha T).
    a: f64,
    alpha_t: f64,
    /// T/alpha [s^2].
    step_s2: f64,
    n_max: f64,
    sigma: f64,
}

impl RateWeight {
    /// Before the first step; T [s] and T/alpha [s^2] are those of the adaptation.
    pub fn new(adaptation: &Adaptation) -> Self {
        let (period_s, step_s2) = (adaptation.period_s, adaptation.step_s2);
        let alpha_t = period_s * period_s / step_s2;
        let mut weight = Self {
            a: exp(-alpha_t),
            alpha_t,
            step_s2,
            n_max: 0.0,
            sigma: 0.0,
        };
        weight.take_size(0.0);
        weight
    }

    /// Takes a step in: sigma holds for every step so far, so it can only fall.
    pub fn take(&mut self, step: &EstimateStep) {
        let size = step.size();
        if size > self.n_max {
            self.take_size(size);
        }
    }

    fn take_size(&mut self, n_max: f64) {
        let most = 1.0 + n_max;
        self.n_max = n_max;
        self.sigma = (1.0 - self.a) / (self.alpha_t * most * most);
    }

    /// sigma = (1 - a)/(alpha T (1 + Nmax)^2).
    pub const fn sigma(&self) -> f64 {
        self.sigma
    }

    /// -sigma/2 (1 - a)|e|^2 - T/(2 alpha)|zb|^2 [rad^2/s^2]: what V may change by in a step from rate error `e`
    /// [rad/s], where nothing is late and no low-pass is on.
    pub fn v_change_bound(&self, e: &Vector3<f64>, zb: &Vector3<f64>) -> f64 {
        -(self.sigma() * (1.0 - self.a) * e.norm_squared() + self.step_s2 * zb.norm_squared()) / 2.0
    }
}
