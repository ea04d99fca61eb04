//! What the rotors can do: the range of their speeds and of each rotor's thrust.
//!
//! The mixer stays inside this range; the outer loop demands no thrust outside it.

use serde::{Deserialize, Serialize};

/// Range of the rotor speed, the same for every rotor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorLimits {
    /// Smallest speed, at which a motor still turns safely [rad/s].
    pub min_rad_s: f64,
    pub max_rad_s: f64,
}

impl Default for RotorLimits {
    fn default() -> Self {
        Self {
            min_rad_s: 30.0,
            max_rad_s: 350.0,
        }
    }
}

impl RotorLimits {
    /// f_min: thrust of one rotor at its smallest speed [N], by (6); `k` is the thrust coefficient [N s^2].
    #[inline]
    pub fn f_min(&self, k: f64) -> f64 {
        k * self.min_rad_s * self.min_rad_s
    }

    /// A total thrust [N], kept to what four rotors give.
    #[inline]
    pub fn limit(&self, u: f64, k: f64) -> f64 {
        u.clamp(4.0 * self.f_min(k), 4.0 * self.f_max(k))
    }

    /// f_max: thrust of one rotor at its largest speed [N], by (6); `k` is the thrust coefficient [N s^2].
    #[inline]
    pub fn f_max(&self, k: f64) -> f64 {
        k * self.max_rad_s * self.max_rad_s
    }
}
