//! Outer loop, inner adaptive loop and mixer in plain numbers, for one trajectory.
//!
//! These are equations (9) to (20), sampled.

use messages::math::{atan2, exp, exp_m1, sin, sin_cos};

use crate::airframe::{Body, thrusts, turn};
use crate::{C, G, I_X, I_Y, I_Z, K, K_T, KAPPA, M, T};

/// K_P [1/s^2] and K_D [1/s].
const K_P: f64 = 1.0;
const K_D: f64 = 1.0;
/// K_eta [1/s].
const K_ETA: [f64; 3] = [8.0, 8.0, 3.0];
/// w_f [rad/s].
const W_F: [f64; 3] = [20.0, 20.0, 3.0];
/// alpha [1/s].
const ALPHA: f64 = 200.0;
const STEP: [f64; 3] = [T / ALPHA * 2e-4, T / ALPHA * 0.6, T / ALPHA * 100.0];
/// w_e [rad/s].
const W_E: f64 = 50.0;
const LO: [f64; 3] = [-1e-3, 0.0, -2.0];
const HI: [f64; 3] = [1e-3, 1.0, 2.0];
/// Bounds of the vertical acceleration [m/s^2], and the tangent of the largest tilt (35 degrees).
const A_MIN: f64 = 0.2 * G;
const A_MAX: f64 = 2.0 * G;
const TILT_MAX: f64 = 0.700_207_538_209_709_7;
/// Bounds of a rotor's thrust [N].
const F_MIN: f64 = K * 30.0 * 30.0;
const F_MAX: f64 = K * 350.0 * 350.0;

/// What the outer loop asks for: thrust [N]; roll, pitch, yaw [rad] with two derivatives.
pub struct AttitudeSetpoint {
    pub u: f64,
    attitude: [f64; 3],
    rate: [f64; 3],
    acceleration: [f64; 3],
}

/// c + a sin(w t) with four derivatives, raised by the ramp `s`.
fn axis(s: &[f64; 5], t: f64, c: f64, a: f64, w: f64) -> [f64; 5] {
    let (sin, cos) = sin_cos(w * t);
    let b0 = c + a * sin;
    let b1 = a * w * cos;
    let b2 = -a * w * w * sin;
    let b3 = -a * w * w * w * cos;
    let b4 = a * w * w * w * w * sin;
    [
        s[0] * b0,
        s[1] * b0 + s[0] * b1,
        s[2] * b0 + 2.0 * s[1] * b1 + s[0] * b2,
        s[3] * b0 + 3.0 * (s[2] * b1 + s[1] * b2) + s[0] * b3,
        s[4] * b0 + 4.0 * (s[3] * b1 + s[1] * b3) + 6.0 * s[2] * b2 + s[0] * b4,
    ]
}

/// The ramp over the first 5 s, with four derivatives.
fn ramp(t: f64) -> [f64; 5] {
    if t >= 5.0 {
        return [1.0, 0.0, 0.0, 0.0, 0.0];
    }
    let y = t / 5.0;
    let z = y * (1.0 - y);
    let dz = 1.0 - 2.0 * y;
    let y2 = y * y;
    let z2 = z * z;
    [
        y2 * y2 * y * (126.0 + y * (-420.0 + y * (540.0 + y * (-315.0 + y * 70.0)))),
        630.0 / 5.0 * z2 * z2,
        2520.0 / 25.0 * z2 * z * dz,
        2520.0 / 125.0 * z2 * (3.0 * dz * dz - 2.0 * z),
        15120.0 / 625.0 * z * dz * (dz * dz - 3.0 * z),
    ]
}

/// Thrust and attitude that bring the body to the trajectory.
pub fn outer(t: f64, b: &Body) -> AttitudeSetpoint {
    let s = ramp(t);
    let x = axis(&s, t, 0.0, 2.0, 0.5);
    let y = axis(&s, t, 0.0, 1.0, 1.0);
    let z = axis(&s, t, 1.5, 0.3, 0.7);
    let psi = axis(&s, t, 0.0, 0.5, 0.4);
    let drag = K_T / M;

    let wanted = |i: usize, d: &[f64; 5]| {
        d[2] + K_D * (d[1] - b.v[i]) + K_P * (d[0] - b.x[i]) + drag * b.v[i]
    };
    let (mut ax, mut ay, az_free) = (wanted(0, &x), wanted(1, &y), wanted(2, &z) + G);
    let az = az_free.clamp(A_MIN, A_MAX);
    let horizontal = (ax * ax + ay * ay).sqrt();
    let limited = az != az_free || horizontal > az * TILT_MAX;
    if horizontal > az * TILT_MAX {
        ax *= az * TILT_MAX / horizontal;
        ay *= az * TILT_MAX / horizontal;
    }

    let (s_psi, c_psi) = sin_cos(psi[0]);
    let across = ax * s_psi - ay * c_psi;
    let along = ax * c_psi + ay * s_psi;
    let phi_d = atan2(across, (along * along + az * az).sqrt());
    let theta_d = atan2(along, az);
    let ahead = if limited {
        [0.0; 4]
    } else {
        tilt_rates(&x, &y, &z, &psi, s_psi, c_psi)
    };

    let [(s_phi, c_phi), (s_th, c_th), (s_yaw, c_yaw)] = b.eta.map(sin_cos);
    let u = M
        * (ax * (c_yaw * s_th * c_phi + s_yaw * s_phi)
            + ay * (s_yaw * s_th * c_phi - c_yaw * s_phi)
            + az * (c_th * c_phi));
    AttitudeSetpoint {
        u: u.clamp(4.0 * F_MIN, 4.0 * F_MAX),
        attitude: [phi_d, theta_d, psi[0]],
        rate: [ahead[0], ahead[1], psi[1]],
        acceleration: [ahead[2], ahead[3], psi[2]],
    }
}

/// d(phi_d), d(theta_d) [rad/s], dd(phi_d), dd(theta_d) [rad/s^2] along the reference.
fn tilt_rates(
    x: &[f64; 5],
    y: &[f64; 5],
    z: &[f64; 5],
    psi: &[f64; 5],
    sin: f64,
    cos: f64,
) -> [f64; 4] {
    let drag = K_T / M;
    let (ax, ay, az) = (
        x[2] + drag * x[1],
        y[2] + drag * y[1],
        z[2] + drag * z[1] + G,
    );
    let (dax, day, daz) = (x[3] + drag * x[2], y[3] + drag * y[2], z[3] + drag * z[2]);
    let (ddax, dday, ddaz) = (x[4] + drag * x[3], y[4] + drag * y[3], z[4] + drag * z[3]);
    let s = ax * sin - ay * cos;
    let c = ax * cos + ay * sin;
    let (da_across, da_along) = (dax * sin - day * cos, dax * cos + day * sin);
    let ds = da_across + psi[1] * c;
    let dc = da_along - psi[1] * s;
    let dds = ddax * sin - dday * cos + psi[1] * da_along + psi[2] * c + psi[1] * dc;
    let ddc = ddax * cos + dday * sin - psi[1] * da_across - psi[2] * s - psi[1] * ds;

    let q = c * c + az * az;
    let dq = 2.0 * (c * dc + az * daz);
    let ddq = 2.0 * (dc * dc + c * ddc + daz * daz + az * ddaz);
    let rho = q.sqrt();
    let drho = dq / (2.0 * rho);
    let ddrho = ddq / (2.0 * rho) - dq * dq / (4.0 * rho * q);
    let n = s * s + q;
    let dphi = (ds * rho - s * drho) / n;
    let dtheta = (dc * az - c * daz) / q;
    [
        dphi,
        dtheta,
        (dds * rho - s * ddrho) / n - dphi * 2.0 * (s * ds + rho * drho) / n,
        (ddc * az - c * ddaz) / q - dtheta * dq / q,
    ]
}

/// The inner loop: what it keeps from tick to tick.
#[derive(Clone, Debug)]
pub struct Inner {
    /// exp(-w_f T) per axis, 1 - p, a_d: computed once.
    decay: [f64; 3],
    fresh: f64,
    gain: f64,
    /// Filtered attitude [rad] and its rate [rad/s].
    ec: [f64; 3],
    e1: [f64; 3],
    theta: [f64; 3],
    /// X, whose lower left element is 0, and Y.
    x: [[f64; 3]; 3],
    y: [f64; 3],
    /// Body rates and sin t of the last tick, from the second on.
    last: Option<([f64; 3], f64)>,
}

impl Default for Inner {
    fn default() -> Self {
        Self {
            decay: W_F.map(|w_f| exp(-w_f * T)),
            fresh: -exp_m1(-W_E * T),
            gain: -exp_m1(-ALPHA * T) / T,
            ec: [0.0; 3],
            e1: [0.0; 3],
            theta: [0.0; 3],
            x: [[0.0; 3]; 3],
            y: [0.0; 3],
            last: None,
        }
    }
}

impl Inner {
    pub fn estimate(&self) -> [f64; 3] {
        self.theta
    }

    /// Torque [N m] at `t` [s]; `w` are the rotor speeds of the tick before [rad/s].
    pub fn tick(&mut self, t: f64, b: &Body, w: &[f64; 4], order: &AttitudeSetpoint) -> [f64; 3] {
        let om = w[0] - w[1] + w[2] - w[3];
        let h = sin(t);
        let nu2 = b.nu;
        if let Some((before, h_before)) = self.last {
            self.learn(&before, h_before, &nu2, h, om, w);
        }
        self.last = Some((nu2, h));

        let mut ec = [0.0; 3];
        let mut e1 = [0.0; 3];
        let mut e2 = [0.0; 3];
        for i in 0..3 {
            let w_f = W_F[i];
            let win =
                order.acceleration[i] + 2.0 * w_f * order.rate[i] + w_f * w_f * order.attitude[i];
            e2[i] = win - 2.0 * w_f * self.e1[i] - w_f * w_f * self.ec[i];
            let target = win / (w_f * w_f);
            let y0 = self.ec[i] - target;
            ec[i] = target + self.decay[i] * ((1.0 + w_f * T) * y0 + T * self.e1[i]);
            e1[i] = self.decay[i] * (-w_f * w_f * T * y0 + (1.0 - w_f * T) * self.e1[i]);
        }

        let ([p, q, r], [phi, theta, psi]) = (b.nu, b.eta);
        let ((s_phi, c_phi), (s_th, c_th)) = (sin_cos(phi), sin_cos(theta));
        let dpsi = (s_phi * q + c_phi * r) / c_th;
        let dphi = p + s_th * dpsi;
        let dtheta = c_phi * q - s_phi * r;
        let yaw_error = {
            use std::f64::consts::{PI, TAU};
            let error = self.ec[2] - psi;
            if error >= PI {
                error - TAU
            } else if error < -PI {
                error + TAU
            } else {
                error
            }
        };
        let xi = [
            self.e1[0] + K_ETA[0] * (self.ec[0] - phi),
            self.e1[1] + K_ETA[1] * (self.ec[1] - theta),
            self.e1[2] + K_ETA[2] * yaw_error,
        ];
        let dxi = [
            e2[0] + K_ETA[0] * (self.e1[0] - dphi),
            e2[1] + K_ETA[1] * (self.e1[1] - dtheta),
            e2[2] + K_ETA[2] * (self.e1[2] - dpsi),
        ];
        let nu2_d = [
            xi[0] - s_th * xi[2],
            c_phi * xi[1] + s_phi * c_th * xi[2],
            -s_phi * xi[1] + c_phi * c_th * xi[2],
        ];
        let dnu2_d = [
            dxi[0] - s_th * dxi[2] - c_th * dtheta * xi[2],
            c_phi * dxi[1] + s_phi * c_th * dxi[2] - s_phi * dphi * xi[1]
                + (c_phi * c_th * dphi - s_phi * s_th * dtheta) * xi[2],
            -s_phi * dxi[1] + c_phi * c_th * dxi[2]
                - c_phi * dphi * xi[1]
                - (s_phi * c_th * dphi + c_phi * s_th * dtheta) * xi[2],
        ];
        self.ec = ec;
        self.e1 = e1;

        let [i_r, k_r, delta] = self.theta;
        [
            I_X * (dnu2_d[0] - self.gain * (p - nu2_d[0]) - delta * h) - (I_Y - I_Z) * q * r
                + i_r * om * q
                + k_r * p,
            I_Y * (dnu2_d[1] - self.gain * (q - nu2_d[1]) - 0.8 * delta * h)
                - (I_Z - I_X) * p * r
                - i_r * om * p
                + k_r * q,
            I_Z * (dnu2_d[2] - self.gain * (r - nu2_d[2]) - 0.6 * delta * h) - (I_X - I_Y) * p * q
                + k_r * r,
        ]
    }

    /// One step of the adaptation, from body rates `a` to `b` [rad/s] under rotor speeds `w` [rad/s].
    fn learn(&mut self, a: &[f64; 3], h_a: f64, b: &[f64; 3], h_b: f64, om: f64, w: &[f64; 4]) {
        let h = (h_a + h_b) / 2.0;
        let [p, q, r]: [f64; 3] = std::array::from_fn(|i| (a[i] + b[i]) / 2.0);
        let x = &mut self.x;
        let n = self.fresh;
        x[0][0] += n * (-om / I_X * q - x[0][0]);
        x[0][1] += n * (-p / I_X - x[0][1]);
        x[0][2] += n * (h - x[0][2]);
        x[1][0] += n * (om / I_Y * p - x[1][0]);
        x[1][1] += n * (-q / I_Y - x[1][1]);
        x[1][2] += n * (0.8 * h - x[1][2]);
        x[2][1] += n * (-r / I_Z - x[2][1]);
        x[2][2] += n * (0.6 * h - x[2][2]);
        let y = &mut self.y;
        let turn = turn(&thrusts(w));
        let inertia = [(I_Y - I_Z) / I_X, (I_Z - I_X) / I_Y, (I_X - I_Y) / I_Z];
        for (i, (j, k)) in [(1, 2), (0, 2), (0, 1)].into_iter().enumerate() {
            let product = (a[j] * a[k] + b[j] * b[k]) / 2.0;
            y[i] += n * ((b[i] - a[i]) / T - inertia[i] * product - turn[i] - y[i]);
        }

        // (I + X G X^T) zb = Y - X theta, by the root-free Cholesky factors; G X^T, then the step along it.
        let theta = &mut self.theta;
        let residual =
            |i: usize| y[i] - x[i][0] * theta[0] - x[i][1] * theta[1] - x[i][2] * theta[2];
        let weight = |i: usize, j: usize| {
            STEP[0] * x[i][0] * x[j][0] + STEP[1] * x[i][1] * x[j][1] + STEP[2] * x[i][2] * x[j][2]
        };
        let d0 = 1.0 + weight(0, 0);
        let (l10, l20) = (weight(1, 0) / d0, weight(2, 0) / d0);
        let d1 = 1.0 + weight(1, 1) - l10 * l10 * d0;
        let l21 = (weight(2, 1) - l20 * l10 * d0) / d1;
        let d2 = 1.0 + weight(2, 2) - l20 * l20 * d0 - l21 * l21 * d1;
        let r0 = residual(0);
        let r1 = residual(1) - l10 * r0;
        let r2 = residual(2) - l20 * r0 - l21 * r1;
        let z2 = r2 / d2;
        let z1 = r1 / d1 - l21 * z2;
        let z0 = r0 / d0 - l10 * z1 - l20 * z2;
        for i in 0..3 {
            let along = x[0][i] * z0 + x[1][i] * z1 + x[2][i] * z2;
            theta[i] = (theta[i] + STEP[i] * along).clamp(LO[i], HI[i]);
        }
    }
}

/// Rotor speeds [rad/s] for thrust [N] and torque [N m]: thrust first, then roll and pitch, then yaw.
pub fn mixer(u: f64, tau: &[f64; 3]) -> [f64; 4] {
    let common = (u / 4.0).clamp(F_MIN, F_MAX);
    let roll = tau[0] / (4.0 * C);
    let pitch = tau[1] / (4.0 * C);
    let yaw = tau[2] / (4.0 * KAPPA);
    let mut f = [common; 4];
    add(
        &mut f,
        &[roll + pitch, pitch - roll, -roll - pitch, roll - pitch],
    );
    add(&mut f, &[yaw, -yaw, yaw, -yaw]);
    f.map(|f| (f / K).sqrt())
}

/// Adds as much of `d` to `f` [N] as the rotors can give.
fn add(f: &mut [f64; 4], d: &[f64; 4]) {
    let mut share = 1.0_f64;
    for i in 0..4 {
        let room = if d[i] > 0.0 {
            F_MAX - f[i]
        } else {
            F_MIN - f[i]
        };
        if room.abs() < d[i].abs() {
            share = share.min(room / d[i]);
        }
    }
    for i in 0..4 {
        f[i] = (f[i] + share * d[i]).clamp(F_MIN, F_MAX);
    }
}
