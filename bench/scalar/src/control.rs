//! Outer loop, inner adaptive loop and mixer by hand, for one trajectory: equations (9) to (20), sampled.

use controller::Trajectory;
use controller::adaptation::Weight;
use controller::flatness::motion;
use messages::frames::{RollPitch, wrap};
use messages::math::{atan2, exp, exp_m1, sin, sin_cos};
use nalgebra::{Matrix3, Vector3, Vector4};

use crate::airframe::{Body, thrusts, turn};
use crate::constants::{C, G, I_X, I_Y, I_Z, K, K_T, KAPPA, M, T};

/// K_P [1/s^2] and K_D [1/s].
const K_P: f64 = 1.0;
const K_D: f64 = 1.0;
/// K_eta [1/s].
const K_ETA: Vector3<f64> = Vector3::new(8.0, 8.0, 3.0);
/// w_f [rad/s].
const W_F: Vector3<f64> = Vector3::new(20.0, 20.0, 3.0);
/// alpha [1/s].
const ALPHA: f64 = 200.0;
const STEP: Vector3<f64> = Vector3::new(T / ALPHA * 2e-4, T / ALPHA * 0.6, T / ALPHA * 100.0);
/// w_e [rad/s].
const W_E: f64 = 50.0;
const LO: Vector3<f64> = Vector3::new(-1e-3, 0.0, -2.0);
const HI: Vector3<f64> = Vector3::new(1e-3, 1.0, 2.0);
/// Bounds of the vertical acceleration [m/s^2], and the tangent of the largest tilt (35 degrees).
const A_MIN: f64 = 0.2 * G;
const A_MAX: f64 = 2.0 * G;
const TILT_MAX: f64 = 0.700_207_538_209_709_7;
/// Bounds of a rotor's thrust [N].
const F_MIN: f64 = K * 30.0 * 30.0;
const F_MAX: f64 = K * 350.0 * 350.0;
/// k_t/m [1/s].
const DRAG: f64 = K_T / M;
const INERTIA: Vector3<f64> = Vector3::new(I_X, I_Y, I_Z);
/// h(t)/sin t, without unit.
const DISTURBANCE: Vector3<f64> = Vector3::new(1.0, 0.8, 0.6);

/// What the outer loop asks for: thrust [N]; roll, pitch, yaw [rad] with two derivatives.
pub struct AttitudeSetpoint {
    pub u: f64,
    attitude: Vector3<f64>,
    rate: Vector3<f64>,
    acceleration: Vector3<f64>,
}

/// Thrust and attitude that bring the body to the trajectory.
pub fn outer(t: f64, b: &Body) -> AttitudeSetpoint {
    let reference = Trajectory::Lissajous.reference(t);
    let [p, v, dv, ddv, dddv] = motion(&reference);
    let gravity = Vector3::new(0.0, 0.0, G);
    let free = dv + K_D * (v - b.v) + K_P * (p - b.x) + DRAG * b.v + gravity;
    let z = free.z.clamp(A_MIN, A_MAX);
    let horizontal = free.xy().norm();
    let is_tilted = horizontal > z * TILT_MAX;
    let scale = if is_tilted {
        z * TILT_MAX / horizontal
    } else {
        1.0
    };
    let a = Vector3::new(free.x * scale, free.y * scale, z);

    let yaw = [
        reference.yaw_rad,
        reference.yaw_rate_rad_s,
        reference.yaw_acceleration_rad_s2,
    ];
    let (sin, cos) = sin_cos(yaw[0]);
    let (across, along) = (a.x * sin - a.y * cos, a.x * cos + a.y * sin);
    let phi = atan2(across, (along * along + z * z).sqrt());
    let [rate, acceleration] = if is_tilted || z != free.z {
        [[0.0; 2]; 2]
    } else {
        let along_reference = [dv + DRAG * v + gravity, ddv + DRAG * dv, dddv + DRAG * ddv];
        tilt_rates(&along_reference, [yaw[1], yaw[2]], sin, cos)
    };
    let u = M * a.dot(&RollPitch::of(&b.eta).rot_wb(b.eta.z).column(2));
    AttitudeSetpoint {
        u: u.clamp(4.0 * F_MIN, 4.0 * F_MAX),
        attitude: Vector3::new(phi, atan2(along, z), yaw[0]),
        rate: Vector3::new(rate[0], rate[1], yaw[1]),
        acceleration: Vector3::new(acceleration[0], acceleration[1], yaw[2]),
    }
}

/// d(phi_d), d(theta_d) [rad/s], dd(phi_d), dd(theta_d) [rad/s^2] where the thrust acceleration and the yaw have these
/// derivatives.
fn tilt_rates(
    [a, da, dda]: &[Vector3<f64>; 3],
    [dpsi, ddpsi]: [f64; 2],
    sin: f64,
    cos: f64,
) -> [[f64; 2]; 2] {
    let across = |a: &Vector3<f64>| a.x * sin - a.y * cos;
    let along = |a: &Vector3<f64>| a.x * cos + a.y * sin;
    let (s, c) = (across(a), along(a));
    let (ds, dc) = (across(da) + dpsi * c, along(da) - dpsi * s);
    let dds = across(dda) + dpsi * along(da) + ddpsi * c + dpsi * dc;
    let ddc = along(dda) - dpsi * across(da) - ddpsi * s - dpsi * ds;
    let q = c * c + a.z * a.z;
    let dq = 2.0 * (c * dc + a.z * da.z);
    let ddq = 2.0 * (dc * dc + c * ddc + da.z * da.z + a.z * dda.z);
    let rho = q.sqrt();
    let drho = dq / (2.0 * rho);
    let ddrho = ddq / (2.0 * rho) - dq * dq / (4.0 * rho * q);
    let n = s * s + q;
    let dphi = (ds * rho - s * drho) / n;
    let dtheta = (dc * a.z - c * da.z) / q;
    let ddphi = (dds * rho - s * ddrho) / n - dphi * 2.0 * (s * ds + rho * drho) / n;
    let ddtheta = (ddc * a.z - c * dda.z) / q - dtheta * dq / q;
    [[dphi, dtheta], [ddphi, ddtheta]]
}

/// The inner loop: what it keeps from tick to tick.
#[derive(Clone, Debug)]
pub struct Inner {
    /// exp(-w_f T) per axis, 1 - p, a_d: computed once.
    decay: Vector3<f64>,
    fresh: f64,
    gain: f64,
    /// Filtered attitude [rad] and its rate [rad/s].
    ec: Vector3<f64>,
    e1: Vector3<f64>,
    theta: Vector3<f64>,
    x: Matrix3<f64>,
    y: Vector3<f64>,
    /// Body rates and sin t of the last tick, from the second on.
    last: Option<(Vector3<f64>, f64)>,
}

impl Default for Inner {
    fn default() -> Self {
        Self {
            decay: W_F.map(|w_f| exp(-w_f * T)),
            fresh: -exp_m1(-W_E * T),
            gain: -exp_m1(-ALPHA * T) / T,
            ec: Vector3::zeros(),
            e1: Vector3::zeros(),
            theta: Vector3::zeros(),
            x: Matrix3::zeros(),
            y: Vector3::zeros(),
            last: None,
        }
    }
}

/// Gyroscopic torque of the body [N m] at body rates [rad/s].
fn coupling(nu: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        (I_Y - I_Z) * nu.y * nu.z,
        (I_Z - I_X) * nu.x * nu.z,
        (I_X - I_Y) * nu.x * nu.y,
    )
}

impl Inner {
    pub fn estimate(&self) -> [f64; 3] {
        self.theta.into()
    }

    /// Torque [N m] at `t` [s]; `w` are the rotor speeds of the tick before [rad/s].
    pub fn tick(
        &mut self,
        t: f64,
        b: &Body,
        w: &Vector4<f64>,
        order: &AttitudeSetpoint,
    ) -> Vector3<f64> {
        let om = w.x - w.y + w.z - w.w;
        let (h, nu) = (sin(t), b.nu);
        if let Some((before, h_before)) = self.last.replace((nu, h)) {
            self.learn([&before, &nu], (h_before + h) / 2.0, om, w);
        }

        let w_f2 = W_F.component_mul(&W_F);
        let win = order.acceleration
            + 2.0 * W_F.component_mul(&order.rate)
            + w_f2.component_mul(&order.attitude);
        let e2 = win - 2.0 * W_F.component_mul(&self.e1) - w_f2.component_mul(&self.ec);
        let roll_pitch = RollPitch::of(&b.eta);
        let d_eta = roll_pitch.euler_rate(&nu);
        let mut error = self.ec - b.eta;
        error.z = wrap(error.z);
        let xi = self.e1 + K_ETA.component_mul(&error);
        let dxi = e2 + K_ETA.component_mul(&(self.e1 - d_eta));
        let nu_d = roll_pitch.body_rate(&xi);
        let dnu_d = roll_pitch.body_rate(&dxi) + roll_pitch.body_rate_dot(&d_eta, &xi);

        let target = win.component_div(&w_f2);
        let y0 = self.ec - target;
        let moved = W_F.component_mul(&y0) + self.e1;
        self.ec = target + self.decay.component_mul(&(y0 + T * moved));
        self.e1 = self
            .decay
            .component_mul(&(self.e1 - T * W_F.component_mul(&moved)));

        let (i_r, k_r, delta) = (self.theta.x, self.theta.y, self.theta.z);
        let wanted = dnu_d - self.gain * (nu - nu_d) - delta * h * DISTURBANCE;
        INERTIA.component_mul(&wanted) - coupling(&nu)
            + k_r * nu
            + i_r * om * Vector3::new(nu.y, -nu.x, 0.0)
    }

    /// One step of the adaptation, from body rates `a` to `b` [rad/s] under rotor speeds `w` [rad/s].
    fn learn(&mut self, [a, b]: [&Vector3<f64>; 2], h: f64, om: f64, w: &Vector4<f64>) {
        let mean = (a + b) / 2.0;
        let drag = -mean.component_div(&INERTIA);
        let spin = Vector3::new(-om * mean.y / I_X, om * mean.x / I_Y, 0.0);
        let phi = Matrix3::from_columns(&[spin, drag, h * DISTURBANCE]);
        let known = (coupling(a) + coupling(b)).component_div(&INERTIA) / 2.0 + turn(&thrusts(w));
        self.x += self.fresh * (phi - self.x);
        self.y += self.fresh * ((b - a) / T - known - self.y);
        // theta <- clip(theta + G X^T W^-1 (Y - X theta))
        if let Some(weight) = Weight::new(&self.x, &STEP) {
            let zb = weight.solve(&(self.y - self.x * self.theta));
            let moved = self.theta + STEP.component_mul(&self.x.tr_mul(&zb));
            self.theta = moved.sup(&LO).inf(&HI);
        }
    }
}

/// Rotor speeds [rad/s] for thrust [N] and torque [N m]: thrust first, then roll and pitch, then yaw.
pub fn mixer(u: f64, tau: &Vector3<f64>) -> Vector4<f64> {
    let common = (u / 4.0).clamp(F_MIN, F_MAX);
    let (roll, pitch) = (tau.x / (4.0 * C), tau.y / (4.0 * C));
    let yaw = tau.z / (4.0 * KAPPA);
    let mut f = Vector4::repeat(common);
    add(
        &mut f,
        &Vector4::new(roll + pitch, pitch - roll, -roll - pitch, roll - pitch),
    );
    add(&mut f, &Vector4::new(yaw, -yaw, yaw, -yaw));
    f.map(|f| (f / K).sqrt())
}

/// Adds as much of `d` to `f` [N] as the rotors can give.
fn add(f: &mut Vector4<f64>, d: &Vector4<f64>) {
    let mut share = 1.0_f64;
    for (f, d) in f.iter().zip(d) {
        let room = if *d > 0.0 { F_MAX - f } else { F_MIN - f };
        if room.abs() < d.abs() {
            share = share.min(room / d);
        }
    }
    *f = (*f + d * share).map(|f| f.clamp(F_MIN, F_MAX));
}
