//! Integrator: classical Runge-Kutta of order 4, by default four steps per tick.
//!
//! It owns the steps and the times of their stages. Inside a tick the rotors' motion and the disturbance h(t) are
//! continuous, so both are evaluated at the stage times. Every time is computed from the integer tick and the step
//! number, never from a sum that runs over ticks: the same tick gives the same bits, however the plant got there.

use messages::math::sin_cos;
use messages::parameters::Airframe;
use messages::rate_dynamics::Disturbances;

use crate::rigid_body::{Dynamics, Forcing, RigidBody, RigidBodyRate};
use crate::rotors::Spin;

/// Runge-Kutta steps per tick by default: 250 us each at 1 kHz.
pub const SUBSTEPS: u32 = 4;

/// The steps of a tick: what is the same in every one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    pub period_s: f64,
    pub(crate) substeps: u32,
    pub(crate) half_s: f64,
    /// Sine and cosine of half a step, by which h(t) goes on.
    pub(crate) turn: (f64, f64),
}

impl Steps {
    /// `substeps` equal steps of a tick of `period_s` [s].
    pub fn new(period_s: f64, substeps: u32) -> Self {
        let half_s = period_s / f64::from(2 * substeps);
        Self {
            period_s,
            substeps,
            half_s,
            turn: sin_cos(half_s),
        }
    }

    /// h(t) at the beginning of a tick, and half a step further each time.
    #[inline]
    pub(crate) fn disturbances(&self, tick: u64) -> Disturbances {
        Disturbances::new(tick as f64 * self.period_s, self.turn)
    }
}

/// Carries a body from grid tick `tick` to the next, `period_s` [s] later, in `substeps` equal steps.
///
/// The parameters and the rotor command (inside `spin`) hold for the whole tick.
pub fn integrate(
    body: &RigidBody,
    airframe: &Airframe,
    spin: &Spin,
    tick: u64,
    period_s: f64,
    substeps: u32,
) -> RigidBody {
    let steps = Steps::new(period_s, substeps);
    integrate_with(
        body,
        &Dynamics::new(airframe),
        spin,
        tick,
        &steps,
        |_, _| {},
    )
}

/// The same, with a function that acts on the body after every step, given where the step began: the ground.
#[inline(always)]
pub fn integrate_with(
    body: &RigidBody,
    dynamics: &Dynamics,
    spin: &Spin,
    tick: u64,
    steps: &Steps,
    mut after_step: impl FnMut(&RigidBody, &mut RigidBody),
) -> RigidBody {
    let half_s = steps.half_s;
    let mut h = steps.disturbances(tick);
    let of_rotors =
        |half_steps: u32| dynamics.forcing(&spin.effort(f64::from(half_steps) * half_s));
    let mut rotors = of_rotors(0);
    let mut body = *body;
    let mut start = dynamics.disturbed(&rotors, &h.next_h());
    for step in 0..steps.substeps {
        // Without a lag the rotors do the same all through the tick.
        if spin.lags() {
            rotors = of_rotors(2 * step + 1);
        }
        let middle = dynamics.disturbed(&rotors, &h.next_h());
        if spin.lags() {
            rotors = of_rotors(2 * step + 2);
        }
        // The end of a step is the instant at which the next one begins.
        let end = dynamics.disturbed(&rotors, &h.next_h());
        let step_start = body;
        body = runge_kutta_4(&body, dynamics, [&start, &middle, &end], half_s);
        after_step(&step_start, &mut body);
        start = end;
    }
    // Four steps stretch the quaternion by less than rounding does, and fewer by less than they err otherwise.
    RigidBody {
        attitude: body.attitude.normalised(),
        ..body
    }
}

/// One classical Runge-Kutta step of twice `half` [s], under the forcing at its start, in its middle and at its end.
// Called, it would hand the body through memory, four times a tick, and each step would wait for that.
#[inline(always)]
pub(crate) fn runge_kutta_4(
    body: &RigidBody,
    dynamics: &Dynamics,
    forcing: [&Forcing; 3],
    half: f64,
) -> RigidBody {
    let [start, middle, end] = forcing;
    let dt = 2.0 * half;
    let k1 = body.rate(dynamics, start);
    let k2 = body.along(&k1, half).rate(dynamics, middle);
    let k3 = body.along(&k2, half).rate(dynamics, middle);
    let k4 = body.along(&k3, dt).rate(dynamics, end);
    let sixth = 1.0 / 6.0;
    let mean = RigidBodyRate {
        d_eta1: (k1.d_eta1 + (k2.d_eta1 + k3.d_eta1) * 2.0 + k4.d_eta1) * sixth,
        d_v: (k1.d_v + (k2.d_v + k3.d_v) * 2.0 + k4.d_v) * sixth,
        d_attitude: (k1.d_attitude + (k2.d_attitude + k3.d_attitude) * 2.0 + k4.d_attitude) * sixth,
        d_nu2: (k1.d_nu2 + (k2.d_nu2 + k3.d_nu2) * 2.0 + k4.d_nu2) * sixth,
    };
    body.along(&mean, dt)
}
