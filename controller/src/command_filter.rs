//! The command filter: a smooth attitude with two derivatives from the set-point.
//!
//! The paper needs d(nu2_d) but does not say where it comes from, so this filter is not in it. It is critically damped
//! and of second order, one per axis. It is exact for a set-point held over the tick, so its result does not depend on
//! T.

use model::math::exp;
use model::messages::Setpoint;
use nalgebra::Vector3;

/// The filter and its state, per axis roll, pitch, yaw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandFilter {
    /// w_f, bandwidth [rad/s].
    pub w_f: Vector3<f64>,
    /// ec, filtered attitude [rad].
    pub ec: Vector3<f64>,
    /// e1, its first derivative [rad/s].
    pub e1: Vector3<f64>,
}

impl CommandFilter {
    /// A filter at rest at an attitude [rad].
    #[must_use]
    pub fn at_rest(w_f: Vector3<f64>, eta2: Vector3<f64>) -> Self {
        Self { w_f, ec: eta2, e1: Vector3::zeros() }
    }

    /// win: the input [rad/s^2] that makes the filter follow a set-point and its derivatives without lag.
    #[must_use]
    pub fn input(&self, setpoint: &Setpoint) -> Vector3<f64> {
        let w_f = &self.w_f;
        let r = Vector3::from(setpoint.attitude_rad);
        let r1 = Vector3::from(setpoint.attitude_rate_rad_s);
        let r2 = Vector3::from(setpoint.attitude_acceleration_rad_s2);
        r2 + 2.0 * w_f.component_mul(&r1) + w_f.component_mul(w_f).component_mul(&r)
    }

    /// e2: second derivative of the filtered attitude [rad/s^2] under an input.
    #[must_use]
    pub fn acceleration(&self, win: &Vector3<f64>) -> Vector3<f64> {
        let Self { w_f, ec, e1 } = self;
        win - 2.0 * w_f.component_mul(e1) - w_f.component_mul(w_f).component_mul(ec)
    }

    /// The filter after `dt_s` [s] under a constant input.
    #[must_use]
    pub fn advance(&self, win: &Vector3<f64>, dt_s: f64) -> Self {
        let mut next = *self;
        for i in 0..3 {
            (next.ec[i], next.e1[i]) = advance_axis(self.ec[i], self.e1[i], win[i], self.w_f[i], dt_s);
        }
        next
    }
}

/// One axis after `dt_s` [s] under a constant `win` [rad/s^2]: (ec [rad], e1 [rad/s]).
#[must_use]
pub fn advance_axis(ec: f64, e1: f64, win: f64, w_f: f64, dt_s: f64) -> (f64, f64) {
    let target = win / (w_f * w_f);
    let y0 = ec - target;
    let decay = exp(-w_f * dt_s);
    (target + decay * ((1.0 + w_f * dt_s) * y0 + dt_s * e1), decay * (-w_f * w_f * dt_s * y0 + (1.0 - w_f * dt_s) * e1))
}
