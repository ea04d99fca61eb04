//! One flight written by hand for one airframe: the minimum cost of a tick.
//!
//! It flies the Lissajous figure with the gains `flight`, the nominal airframe and no swap, at 1 kHz. Plant, outer
//! loop, inner adaptive loop and mixer are written as one would write them in C for one airframe and nothing else.
//! Constants are known to the compiler, and what does not change within a tick is computed once. There is no setting,
//! message, mode or check, and of the sensors only what the loops look at. Frames, quaternions, the trajectory and the
//! factors of a 3x3 matrix are the rig's functions. The theorem's monitor has no counterpart here; [`laws::Laws`] flies
//! the rig's own laws without it.
//!
//! The equations are those of docs/paper.md; the symbols are those of docs/conventions.md. Over a flight it follows the
//! rig's laws to 1e-9 (tested in [`timing`]), not bit by bit, because it orders its operations differently.

mod airframe;
mod constants;
mod control;
pub mod laws;
pub mod timing;

use airframe::Body;
use constants::{G, K, M, T};
use control::{Inner, mixer, outer};
use nalgebra::Vector4;

#[derive(Clone, Debug)]
pub struct ScalarFlight {
    tick: u64,
    body: Body,
    /// Rotor speeds of the tick before, of this tick, and of the next [rad/s].
    speed_last: Vector4<f64>,
    speed: Vector4<f64>,
    inner: Inner,
}

/// What a tick came to, for comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalarSample {
    /// Position, velocity (world frame), attitude, body rates at the tick [m, m/s, rad, rad/s].
    pub body: [[f64; 3]; 4],
    /// Thrust [N] and torque [N m] asked for.
    pub wrench: [f64; 4],
    /// Estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub estimate: [f64; 3],
    /// Rotor speeds commanded [rad/s].
    pub speed: [f64; 4],
}

impl ScalarFlight {
    pub fn tick(&mut self) -> ScalarSample {
        let t = self.tick as f64 * T;
        let body = self.body;
        let order = outer(t, &body);
        let tau = self.inner.tick(t, &body, &self.speed_last, &order);
        let command = mixer(order.u, &tau);
        self.body = airframe::fly(&body, t, &self.speed);
        self.speed_last = self.speed;
        self.speed = command;
        self.tick += 1;
        ScalarSample {
            body: [body.x, body.v, body.eta, body.nu].map(Into::into),
            wrench: [order.u, tau.x, tau.y, tau.z],
            estimate: self.inner.estimate(),
            speed: command.into(),
        }
    }
}

impl Default for ScalarFlight {
    /// The flight before tick 0: at rest in the origin, rotors at hover speed.
    fn default() -> Self {
        let hover = (M * G / (4.0 * K)).sqrt();
        Self {
            tick: 0,
            body: Body::default(),
            speed_last: Vector4::repeat(hover),
            speed: Vector4::repeat(hover),
            inner: Inner::default(),
        }
    }
}
