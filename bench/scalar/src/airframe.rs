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

/// Position and velocity in the world frame [m, m/s], attitude as quaternion, body rates [rad/s], and the attitude as
/// roll, pitch, yaw [rad], which follows once a tick.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub vx: f64,
    pub vy: f64,
    pub vz: f64,
    pub qw: f64,
    pub qx: f64,
    pub qy: f64,
    pub qz: f64,
    pub p: f64,
    pub q: f64,
    pub r: f64,
    pub phi: f64,
    pub theta: f64,
    pub psi: f64,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            x: 0.0,
            y: 0.0,
            z: 0.0,
            vx: 0.0,
            vy: 0.0,
            vz: 0.0,
            qw: 1.0,
            qx: 0.0,
            qy: 0.0,
            qz: 0.0,
            p: 0.0,
            q: 0.0,
            r: 0.0,
            phi: 0.0,
            theta: 0.0,
            psi: 0.0,
        }
    }
}

/// What the rotors do in a tick: thrust over mass [m/s^2], torque over inertia [rad/s^2], net speed [rad/s].
struct Push {
    lift: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
    om: f64,
}

impl Body {
    pub fn numbers(&self) -> [f64; 12] {
        let &Self {
            x,
            y,
            z,
            vx,
            vy,
            vz,
            phi,
            theta,
            psi,
            p,
            q,
            r,
            ..
        } = self;
        [x, y, z, vx, vy, vz, phi, theta, psi, p, q, r]
    }

    /// The body moved along a derivative for `dt` [s].
    fn along(&self, d: &Self, dt: f64) -> Self {
        Self {
            x: self.x + d.x * dt,
            y: self.y + d.y * dt,
            z: self.z + d.z * dt,
            vx: self.vx + d.vx * dt,
            vy: self.vy + d.vy * dt,
            vz: self.vz + d.vz * dt,
            qw: self.qw + d.qw * dt,
            qx: self.qx + d.qx * dt,
            qy: self.qy + d.qy * dt,
            qz: self.qz + d.qz * dt,
            p: self.p + d.p * dt,
            q: self.q + d.q * dt,
            r: self.r + d.r * dt,
            ..*self
        }
    }

    /// Its derivative; `h` is delta sin t [rad/s^2].
    fn rate(&self, push: &Push, h: f64) -> Self {
        let &Self {
            vx,
            vy,
            vz,
            qw,
            qx,
            qy,
            qz,
            p,
            q,
            r,
            ..
        } = self;
        let (hp, hq, hr) = (p / 2.0, q / 2.0, r / 2.0);
        Self {
            x: vx,
            y: vy,
            z: vz,
            vx: 2.0 * (qx * qz + qw * qy) * push.lift - K_T / M * vx,
            vy: 2.0 * (qy * qz - qw * qx) * push.lift - K_T / M * vy,
            vz: (1.0 - 2.0 * (qx * qx + qy * qy)) * push.lift - G - K_T / M * vz,
            qw: -qx * hp - qy * hq - qz * hr,
            qx: qw * hp + qy * hr - qz * hq,
            qy: qw * hq + qz * hp - qx * hr,
            qz: qw * hr + qx * hq - qy * hp,
            p: (I_Y - I_Z) / I_X * q * r - I_R / I_X * push.om * q - K_R / I_X * p + h + push.roll,
            q: (I_Z - I_X) / I_Y * p * r + I_R / I_Y * push.om * p - K_R / I_Y * q
                + 0.8 * h
                + push.pitch,
            r: (I_X - I_Y) / I_Z * p * q - K_R / I_Z * r + 0.6 * h + push.yaw,
            ..*self
        }
    }

    /// The quaternion at length 1, and roll, pitch, yaw of it; yaw on the turn that is nearest to the last.
    fn settled(&self) -> Self {
        let &Self { qw, qx, qy, qz, .. } = self;
        let shrink = 1.0 / (qw * qw + qx * qx + qy * qy + qz * qz).sqrt();
        let (qw, qx, qy, qz) = (qw * shrink, qx * shrink, qy * shrink, qz * shrink);
        let (r11, r21) = (1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz));
        let psi = atan2(r21, r11);
        Self {
            qw,
            qx,
            qy,
            qz,
            phi: atan2(2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)),
            theta: atan2(2.0 * (qw * qy - qx * qz), (r11 * r11 + r21 * r21).sqrt()),
            psi: psi + ((self.psi - psi) / TAU).round() * TAU,
            ..*self
        }
    }
}

/// The body one tick after `t` [s], under rotor speeds `w` [rad/s].
pub fn fly(body: &Body, t: f64, w: &[f64; 4]) -> Body {
    let f = [
        K * w[0] * w[0],
        K * w[1] * w[1],
        K * w[2] * w[2],
        K * w[3] * w[3],
    ];
    let push = Push {
        lift: (f[0] + f[1] + f[2] + f[3]) / M,
        roll: C / I_X * (f[0] - f[1] - f[2] + f[3]),
        pitch: C / I_Y * (f[0] + f[1] - f[2] - f[3]),
        yaw: KAPPA / I_Z * (f[0] - f[1] + f[2] - f[3]),
        om: w[0] - w[1] + w[2] - w[3],
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
        b = b
            .along(&k1, H / 6.0)
            .along(&k2, H / 3.0)
            .along(&k3, H / 3.0)
            .along(&k4, H / 6.0);
        h_start = h_end;
    }
    b.settled()
}
