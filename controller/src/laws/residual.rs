//! The residual of [`crate::laws::adaptive_residual`].

use control_api::law::Fields;
use messages::math::exp;
use nalgebra::Vector3;

use crate::adaptation::{Adaptation, LastTick};

/// The low-pass over what the estimates leave unexplained.
#[derive(Clone, Debug)]
pub struct Residual {
    kept: f64,
    /// l [rad/s^2].
    l: Vector3<f64>,
}

impl Residual {
    pub fn new(w_c: f64, period_s: f64) -> Self {
        Self {
            kept: exp(-w_c * period_s),
            l: Vector3::zeros(),
        }
    }

    /// Takes a whole tick, and the estimates after it.
    pub fn take(&mut self, adaptation: &Adaptation, theta: &Vector3<f64>, last: &LastTick) {
        let (phi, y) = adaptation.sample(last);
        self.l = self.kept * self.l + (1.0 - self.kept) * (y - phi * theta);
    }

    pub fn forget(&mut self) {
        self.l = Vector3::zeros();
    }

    /// l [rad/s^2].
    pub const fn left(&self) -> &Vector3<f64> {
        &self.l
    }

    pub fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.l]);
    }
}
