//! Integrator: classical Runge-Kutta of order 4, four steps per tick.
//!
//! Owns the steps and the times of their stages. The rotors' motion and the disturbance h(t) are continuous inside the
//! tick, so both are evaluated at the stage times. Every time comes from the integer tick and the number of the step,
//! never from a running sum: the same tick gives the same bits, however the plant got there.

use shared::parameters::Airframe;

use crate::rigid_body::{RigidBody, RigidBodyRate};
use crate::rotors::{Spin, effort};

/// Runge-Kutta steps per tick: 250 us each at 1 kHz.
pub const SUBSTEPS: u32 = 4;

/// Carries a body from grid tick `tick` to the next, `period_s` [s] later, in `substeps` equal steps.
///
/// The parameters and the rotor command (inside `spin`) hold for the whole tick. The stage uses [`SUBSTEPS`]; other
/// numbers of steps are there to measure the order of convergence.
#[must_use]
pub fn integrate(
    body: &RigidBody,
    airframe: &Airframe,
    spin: &Spin,
    tick: u64,
    period_s: f64,
    substeps: u32,
) -> RigidBody {
    let tick_s = tick as f64 * period_s;
    let step_s = period_s / f64::from(substeps);
    let rate = |offset_s: f64, body: &RigidBody| {
        body.rate(airframe, &effort(airframe, &spin.speed(offset_s)), tick_s + offset_s)
    };
    (0..substeps).fold(*body, |body, step| runge_kutta_4(rate, &body, f64::from(step) * step_s, step_s))
}

/// One classical Runge-Kutta step of `dt` [s] from `t` [s].
fn runge_kutta_4(rate: impl Fn(f64, &RigidBody) -> RigidBodyRate, body: &RigidBody, t: f64, dt: f64) -> RigidBody {
    let half = dt / 2.0;
    let k1 = rate(t, body);
    let k2 = rate(t + half, &body.along(&k1, half));
    let k3 = rate(t + half, &body.along(&k2, half));
    let k4 = rate(t + dt, &body.along(&k3, dt));
    let mean = RigidBodyRate {
        d_eta1: (k1.d_eta1 + (k2.d_eta1 + k3.d_eta1) * 2.0 + k4.d_eta1) / 6.0,
        d_v: (k1.d_v + (k2.d_v + k3.d_v) * 2.0 + k4.d_v) / 6.0,
        d_eta2: (k1.d_eta2 + (k2.d_eta2 + k3.d_eta2) * 2.0 + k4.d_eta2) / 6.0,
        d_nu2: (k1.d_nu2 + (k2.d_nu2 + k3.d_nu2) * 2.0 + k4.d_nu2) / 6.0,
    };
    body.along(&mean, dt)
}
