//! The airframe by hand: (1), (3), (4), (6) to (8), four Runge-Kutta steps per tick.

use messages::attitude::Attitude;
use messages::math::sin_cos;
use nalgebra::{Vector3, Vector4};

use crate::constants::{C, G, I_X, I_Y, I_Z, K, K_T, KAPPA, M, T};

/// I_R [kg m^2], k_r [N m s], delta [rad/s^2] as they are.
const I_R: f64 = 3.36e-5;
const K_R: f64 = 0.105;
const DELTA: f64 = 0.2;

const STEPS: usize = 4;
/// Length of one [s].
const H: f64 = T / STEPS as f64;

/// Position and velocity in the world frame [m, m/s], attitude, body rates [rad/s], and the attitude as roll, pitch, yaw
/// [rad], which follows once a tick.
#[derive(Clone, Copy, Debug, Default)]
pub struct Body {
    pub x: Vector3<f64>,
    pub v: Vector3<f64>,
    pub q: Attitude,
    pub nu: Vector3<f64>,
    pub eta: Vector3<f64>,
}

struct Rate {
    x: Vector3<f64>,
    v: Vector3<f64>,
    q: Vector4<f64>,
    nu: Vector3<f64>,
}

/// What the rotors do in a tick: thrust over mass [m/s^2], torque over inertia [rad/s^2], net speed [rad/s].
struct Push {
    lift: f64,
    turn: Vector3<f64>,
    om: f64,
}

/// Thrust [N] of each rotor at its speed [rad/s].
pub fn thrusts(w: &Vector4<f64>) -> Vector4<f64> {
    w.component_mul(w) * K
}

/// Torque over inertia [rad/s^2] of rotor thrusts [N].
pub fn turn(f: &Vector4<f64>) -> Vector3<f64> {
    Vector3::new(
        C / I_X * (f.x - f.y - f.z + f.w),
        C / I_Y * (f.x + f.y - f.z - f.w),
        KAPPA / I_Z * (f.x - f.y + f.z - f.w),
    )
}

impl Body {
    /// The body moved along a derivative for `dt` [s].
    #[inline(always)]
    fn along(&self, d: &Rate, dt: f64) -> Self {
        Self {
            x: self.x + d.x * dt,
            v: self.v + d.v * dt,
            q: self.q.along(&d.q, dt),
            nu: self.nu + d.nu * dt,
            eta: self.eta,
        }
    }

    /// Its derivative; `h` is delta sin t [rad/s^2].
    #[inline(always)]
    fn rate(&self, push: &Push, h: f64) -> Rate {
        let (p, q, r) = (self.nu.x, self.nu.y, self.nu.z);
        let coupling = Vector3::new(
            (I_Y - I_Z) / I_X * q * r - I_R / I_X * push.om * q - K_R / I_X * p + h,
            (I_Z - I_X) / I_Y * p * r + I_R / I_Y * push.om * p - K_R / I_Y * q + 0.8 * h,
            (I_X - I_Y) / I_Z * p * q - K_R / I_Z * r + 0.6 * h,
        );
        Rate {
            x: self.v,
            v: self.q.z_b_in_w() * push.lift - self.v * (K_T / M) - Vector3::new(0.0, 0.0, G),
            q: self.q.rate(&self.nu),
            nu: coupling + push.turn,
        }
    }
}

/// The body one tick after `t` [s], under rotor speeds `w` [rad/s].
pub fn fly(body: &Body, t: f64, w: &Vector4<f64>) -> Body {
    let f = thrusts(w);
    let push = Push {
        lift: f.sum() / M,
        turn: turn(&f),
        om: w.x - w.y + w.z - w.w,
    };
    let mut b = *body;
    // delta sin t, half a step further each time: sin(t + dt) = sin t cos dt + cos t sin dt.
    let (mut sin, mut cos) = sin_cos(t);
    let (sin_half, cos_half) = sin_cos(H / 2.0);
    let mut h_next = || {
        let h = DELTA * sin;
        (sin, cos) = (
            sin * cos_half + cos * sin_half,
            cos * cos_half - sin * sin_half,
        );
        h
    };
    let mut h_start = h_next();
    for _ in 0..STEPS {
        let (h_middle, h_end) = (h_next(), h_next());
        let k1 = b.rate(&push, h_start);
        let k2 = b.along(&k1, H / 2.0).rate(&push, h_middle);
        let k3 = b.along(&k2, H / 2.0).rate(&push, h_middle);
        let k4 = b.along(&k3, H).rate(&push, h_end);
        for (k, share) in [(k1, 6.0), (k2, 3.0), (k3, 3.0), (k4, 6.0)] {
            b = b.along(&k, H / share);
        }
        h_start = h_end;
    }
    b.q = b.q.normalised();
    b.eta = b.q.euler_near(&b.eta);
    b
}
