//! Integrator: classical Runge-Kutta of order 4, four steps per tick.
//!
//! It owns the steps and the times of their stages. Inside a tick the rotors' motion and the disturbance h(t) are
//! continuous, so both are evaluated at the stage times. Every time is computed from the integer tick and the step
//! number, never from a running sum: the same tick gives the same bits, however the plant got there.

use model::parameters::Airframe;
use model::rate_dynamics::disturbance;

use crate::rigid_body::{Forcing, RigidBody, RigidBodyRate};
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
    let half_s = period_s / f64::from(2 * substeps);
    // Of the number of half steps, so that the end of a step is the instant at which the next one begins.
    let offset_s = |half_steps: u32| f64::from(half_steps) * half_s;
    let (mut body, mut start) = (*body, forcing(airframe, spin, tick_s, 0.0));
    for step in 0..substeps {
        let middle = forcing(airframe, spin, tick_s, offset_s(2 * step + 1));
        let end = forcing(airframe, spin, tick_s, offset_s(2 * step + 2));
        body = runge_kutta_4(&body, airframe, [&start, &middle, &end], half_s);
        start = end;
    }
    body
}

/// The forcing `offset_s` [s] after a tick at `tick_s` [s].
// Part of the loop over the steps, as `RigidBody::rate` is.
#[inline(always)]
fn forcing(airframe: &Airframe, spin: &Spin, tick_s: f64, offset_s: f64) -> Forcing {
    Forcing { effort: effort(airframe, &spin.speed(offset_s)), h: disturbance(tick_s + offset_s) }
}

/// One classical Runge-Kutta step of twice `half` [s], under the forcing at its start, in its middle and at its end.
fn runge_kutta_4(body: &RigidBody, airframe: &Airframe, forcing: [&Forcing; 3], half: f64) -> RigidBody {
    let [start, middle, end] = forcing;
    let dt = 2.0 * half;
    let k1 = body.rate(airframe, start);
    let k2 = body.along(&k1, half).rate(airframe, middle);
    let k3 = body.along(&k2, half).rate(airframe, middle);
    let k4 = body.along(&k3, dt).rate(airframe, end);
    let sixth = 1.0 / 6.0;
    let mean = RigidBodyRate {
        d_eta1: (k1.d_eta1 + (k2.d_eta1 + k3.d_eta1) * 2.0 + k4.d_eta1) * sixth,
        d_v: (k1.d_v + (k2.d_v + k3.d_v) * 2.0 + k4.d_v) * sixth,
        d_eta2: (k1.d_eta2 + (k2.d_eta2 + k3.d_eta2) * 2.0 + k4.d_eta2) * sixth,
        d_nu2: (k1.d_nu2 + (k2.d_nu2 + k3.d_nu2) * 2.0 + k4.d_nu2) * sixth,
    };
    body.along(&mean, dt)
}
