//! The airframe in plain numbers: (1), (3), (4), (6) to (8), a quaternion, four Runge-Kutta steps per tick.

use std::f64::consts::TAU;

use messages::math::{atan2, sin_cos};

use crate::{C, G, I_X, I_Y, I_Z, K, K_T, KAPPA, M, T};

/// I_R [kg m^2], k_r [N m s], delta [rad/s^2] as they are.
const I_R: f64 = 3.36e-5;
const K_R: f64 = 0.105;
const DELTA: f64 = 0.2;

const STEPS: usize = 4;
/// Length of one [s].
const H: f64 = T / STEPS as f64;

/// Position and velocity in the world frame [m, m/s], attitude as quaternion w, x, y, z, body rates [rad/s], and the
/// attitude as roll, pitch, yaw [rad], which follows once a tick.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    pub x: [f64; 3],
    pub v: [f64; 3],
    pub q: [f64; 4],
    pub nu: [f64; 3],
    pub eta: [f64; 3],
}

impl Default for Body {
    fn default() -> Self {
        Self {
            x: [0.0; 3],
            v: [0.0; 3],
            q: [1.0, 0.0, 0.0, 0.0],
            nu: [0.0; 3],
            eta: [0.0; 3],
        }
    }
}

/// What the rotors do in a tick: thrust over mass [m/s^2], torque over inertia [rad/s^2], net speed [rad/s].
struct Push {
    lift: f64,
    turn: [f64; 3],
    om: f64,
}

/// Thrust [N] of each rotor at its speed [rad/s].
pub fn thrusts(w: &[f64; 4]) -> [f64; 4] {
    w.map(|w| K * w * w)
}

/// Torque over inertia [rad/s^2] of rotor thrusts [N].
pub fn turn(f: &[f64; 4]) -> [f64; 3] {
    [
        C / I_X * (f[0] - f[1] - f[2] + f[3]),
        C / I_Y * (f[0] + f[1] - f[2] - f[3]),
        KAPPA / I_Z * (f[0] - f[1] + f[2] - f[3]),
    ]
}

/// `a + d dt`.
#[inline(always)]
fn along<const N: usize>(a: &[f64; N], d: &[f64; N], dt: f64) -> [f64; N] {
    std::array::from_fn(|i| a[i] + d[i] * dt)
}

impl Body {
    /// The body moved along a derivative for `dt` [s].
    #[inline(always)]
    fn along(&self, d: &Self, dt: f64) -> Self {
        Self {
            x: along(&self.x, &d.x, dt),
            v: along(&self.v, &d.v, dt),
            q: along(&self.q, &d.q, dt),
            nu: along(&self.nu, &d.nu, dt),
            ..*self
        }
    }

    /// Its derivative; `h` is delta sin t [rad/s^2].
    #[inline(always)]
    fn rate(&self, push: &Push, h: f64) -> Self {
        let (v, [qw, qx, qy, qz], [p, q, r]) = (self.v, self.q, self.nu);
        let (hp, hq, hr) = (p / 2.0, q / 2.0, r / 2.0);
        Self {
            x: v,
            v: [
                2.0 * (qx * qz + qw * qy) * push.lift - K_T / M * v[0],
                2.0 * (qy * qz - qw * qx) * push.lift - K_T / M * v[1],
                (1.0 - 2.0 * (qx * qx + qy * qy)) * push.lift - G - K_T / M * v[2],
            ],
            q: [
                -qx * hp - qy * hq - qz * hr,
                qw * hp + qy * hr - qz * hq,
                qw * hq + qz * hp - qx * hr,
                qw * hr + qx * hq - qy * hp,
            ],
            nu: [
                (I_Y - I_Z) / I_X * q * r - I_R / I_X * push.om * q - K_R / I_X * p
                    + h
                    + push.turn[0],
                (I_Z - I_X) / I_Y * p * r + I_R / I_Y * push.om * p - K_R / I_Y * q
                    + 0.8 * h
                    + push.turn[1],
                (I_X - I_Y) / I_Z * p * q - K_R / I_Z * r + 0.6 * h + push.turn[2],
            ],
            ..*self
        }
    }

    /// The quaternion at length 1, and roll, pitch, yaw of it; yaw on the turn that is nearest to the last.
    fn settled(&self) -> Self {
        let shrink = 1.0 / self.q.iter().map(|q| q * q).sum::<f64>().sqrt();
        let q = self.q.map(|q| q * shrink);
        let [qw, qx, qy, qz] = q;
        let (r11, r21) = (1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz));
        let phi = atan2(2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy));
        let theta = atan2(2.0 * (qw * qy - qx * qz), (r11 * r11 + r21 * r21).sqrt());
        let psi = atan2(r21, r11);
        let turns = ((self.eta[2] - psi) / TAU).round();
        let eta = [phi, theta, psi + turns * TAU];
        Self { q, eta, ..*self }
    }
}

/// The body one tick after `t` [s], under rotor speeds `w` [rad/s].
pub fn fly(body: &Body, t: f64, w: &[f64; 4]) -> Body {
    let f = thrusts(w);
    let push = Push {
        lift: (f[0] + f[1] + f[2] + f[3]) / M,
        turn: turn(&f),
        om: w[0] - w[1] + w[2] - w[3],
    };
    let mut b = *body;
    // delta sin t, half a step further each time: sin(t + dt) = sin t cos dt + cos t sin dt.
    let (mut sin, mut cos) = sin_cos(t);
    let (sin_half, cos_half) = sin_cos(H / 2.0);
    let mut h_next = || {
        let h = DELTA * sin;
        let next_sin = sin * cos_half + cos * sin_half;
        cos = cos * cos_half - sin * sin_half;
        sin = next_sin;
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
    b.settled()
}
