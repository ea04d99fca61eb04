//! The command filter: a smooth attitude with two derivatives from the setpoint.
//!
//! The paper needs d(nu2_d) but does not say where it comes from, so this filter is not in it. It is critically damped
//! and of second order, one per axis. It is exact for a setpoint held over the tick, so its result does not depend on
//! T.

use control_api::law::Desired;
use messages::math::exp;
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
    pub fn at_rest(w_f: Vector3<f64>, eta2: Vector3<f64>) -> Self {
        Self {
            w_f,
            ec: eta2,
            e1: Vector3::zeros(),
        }
    }

    /// win: the input [rad/s^2] that makes the filter follow a setpoint and its derivatives without lag.
    pub fn input(&self, wanted: &Desired) -> Vector3<f64> {
        let w_f = &self.w_f;
        let r = Vector3::from(wanted.attitude_rad);
        let r1 = Vector3::from(wanted.attitude_rate_rad_s);
        let r2 = Vector3::from(wanted.attitude_acceleration_rad_s2);
        r2 + 2.0 * w_f.component_mul(&r1) + w_f.component_mul(w_f).component_mul(&r)
    }

    /// e2: second derivative of the filtered attitude [rad/s^2] under an input.
    pub fn acceleration(&self, win: &Vector3<f64>) -> Vector3<f64> {
        let Self { w_f, ec, e1 } = self;
        win - 2.0 * w_f.component_mul(e1) - w_f.component_mul(w_f).component_mul(ec)
    }

    /// The filter after a time under a constant input.
    pub fn advance(&self, win: &Vector3<f64>, over: &Passage) -> Self {
        let Self { w_f, ec, e1 } = self;
        let (dt_s, w_f_dt, decay) = (over.dt_s, &over.w_f_dt, &over.decay);
        let target = win.component_div(&w_f.component_mul(w_f));
        let y0 = ec - target;
        let keep_ec = y0 + w_f_dt.component_mul(&y0) + dt_s * e1;
        let keep_e1 = e1 - w_f_dt.component_mul(&(w_f.component_mul(&y0) + e1));
        Self {
            w_f: *w_f,
            ec: target + decay.component_mul(&keep_ec),
            e1: decay.component_mul(&keep_e1),
        }
    }
}

/// A length of time, as the filter goes through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    dt_s: f64,
    w_f_dt: Vector3<f64>,
    /// E = exp(-w_f dt), per axis.
    decay: Vector3<f64>,
}

impl Passage {
    /// `dt_s` [s] of a filter with the bandwidth `w_f` [rad/s].
    pub fn new(w_f: &Vector3<f64>, dt_s: f64) -> Self {
        let w_f_dt = w_f * dt_s;
        Self {
            dt_s,
            w_f_dt,
            decay: w_f_dt.map(|x| exp(-x)),
        }
    }
}
