//! Inner law `geometric`: position and attitude in one, on the rotation matrix.
//!
//! Source: Taeyoung Lee, Melvin Leok, N. Harris McClamroch, "Geometric Tracking Control of a Quadrotor UAV on SE(3)",
//! 49th IEEE Conference on Decision and Control, 2010; arXiv:1003.2005. It takes the reference, not what the outer law
//! wants, and overrides the thrust. Nothing in it is singular: it recovers from almost every attitude.
//!
//! ```text
//!     e_x = x - x_d, e_v = v - v_d                A = -k_x e_x - k_v e_v + m g e3 + m dv_d + k_t v
//!     f = A . R e3                                 b3 = A/|A|, b2 = b3 x b1d/|b3 x b1d|, R_d = [b2 x b3, b2, b3]
//!     e_R = 1/2 (R_d^T R - R^T R_d)^vee            e_Omega = Omega - R^T R_d Omega_d
//!     M = -k_R e_R - k_Omega e_Omega + Omega x J Omega - J(Omega^ R^T R_d Omega_d - R^T R_d dOmega_d)
//!         + k_r R^T R_d Omega_d
//! ```
//!
//! Differences from the paper:
//! * z is up, so the thrust points along +e3 and gravity enters with the other sign.
//! * The drags are known: k_t v stands in A, so that m de_v = -k_x e_x - k_v e_v still holds for R = R_d, and
//!   k_r R^T R_d Omega_d in M. The drag of the rate *error* is left to damp.
//! * k_x, k_v, k_R, k_Omega are frequencies times mass and inertia: k_x = m `position_1_s2`, k_v = m `velocity_1_s`,
//!   k_R = J `attitude_rad_s`^2, k_Omega = J `rate_1_s` per axis. So they fit any airframe.
//! * A/m is limited as in [`crate::limits`]. So |A| > 0, and b3 is never level with b1d. While A is limited, R_d counts
//!   as still.
//! * f is limited to what the rotors give. Where they have no room left for roll and pitch of M, it gives way, towards
//!   m g at most: at their least thrust rotors give no torque, and an inverted vehicle would stay so.

use std::f64::consts::SQRT_2;

use control_api::description::{Description, Refused, Settings, number, settings, signal, three};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::allocation::Allocation;
use messages::attitude::Attitude;
use messages::content::{Measured, Reference};
use messages::math::sin_cos;
use messages::role::Role;
use messages::telemetry::Telemetry;
use nalgebra::{Matrix3, Vector3};

use crate::flatness::motion;
use crate::laws::cascade;
use crate::limits::{self, AccelerationLimits, Limits};

settings! {
    SETTINGS;
    POSITION = "position_1_s2", "1/s^2", number(4.0, 0.01, 100.0), "k_x/m of the position error";
    VELOCITY = "velocity_1_s", "1/s", number(3.4, 0.01, 100.0), "k_v/m of the velocity error";
    ATTITUDE = "attitude_rad_s", "rad/s", three([14.0 * SQRT_2, 14.0 * SQRT_2, 6.0 * SQRT_2], 0.1, 200.0), "root of k_R/J of the attitude error: roll, pitch, yaw";
    RATE = "rate_1_s", "1/s", three([40.0, 40.0, 15.0], 0.1, 1000.0), "k_Omega/J of the rate error: roll, pitch, yaw";
    ACCELERATION_Z_MIN = "acceleration_z_min_g", "g", number(0.2, 0.01, 1.0), "smallest vertical acceleration of A/m";
    ACCELERATION_Z_MAX = "acceleration_z_max_g", "g", number(2.0, 1.0, 20.0), "largest vertical acceleration of A/m";
    TILT_MAX = "tilt_max_rad", "rad", number(60_f64.to_radians(), 0.001, 1.5), "largest angle between A and the vertical";
}

/// The law. It keeps only what to hold in a tick without a measurement.
#[derive(Clone, Debug)]
pub struct Geometric {
    rig: Rig,
    /// k_x/m [1/s^2], k_v/m [1/s].
    k_x: f64,
    k_v: f64,
    /// k_R/J [1/s^2], k_Omega/J [1/s].
    k_r: Vector3<f64>,
    k_omega: Vector3<f64>,
    limits: AccelerationLimits,
    allocation: Allocation,
    /// What all rotors give at least and at most [N], and m g.
    f_min: f64,
    f_max: f64,
    weight_n: f64,
    f: f64,
}

impl Law for Geometric {
    const DESCRIPTION: Description = Description {
        name: "geometric",
        role: Role::Inner,
        version: "2",
        summary: "tracking control of position and attitude in one, for all attitudes; overrides the outer law",
        source: "Lee, Leok, McClamroch, Geometric Tracking Control of a Quadrotor UAV on SE(3), CDC 2010, \
                 arXiv:1003.2005",
        settings: SETTINGS,
        presets: &[],
        suited: Some(|settings, rig| {
            limits::suited(settings, &ACCELERATION_Z_MIN, &ACCELERATION_Z_MAX, rig)
        }),
        telemetry: &[
            signal("position_error_m", "m"),
            signal("attitude_error", ""),
            signal("rate_error_x_rad_s", "rad/s"),
            signal("rate_error_y_rad_s", "rad/s"),
            signal("rate_error_z_rad_s", "rad/s"),
            signal("limited", ""),
        ],
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let names = [&ACCELERATION_Z_MIN, &ACCELERATION_Z_MAX, &TILT_MAX];
        let limits = Limits::new(settings, names);
        cascade::check_limits(&limits)?;
        let (attitude, rate) = (settings.three(&ATTITUDE), settings.three(&RATE));
        cascade::check((&ATTITUDE, &attitude), (&RATE, &rate), rig.period_s)?;
        let (k, weight_n) = (rig.airframe.k(), rig.airframe.m() * rig.airframe.g());
        Ok(Self {
            rig: *rig,
            k_x: settings.number(&POSITION),
            k_v: settings.number(&VELOCITY),
            k_r: attitude.map(|w| w * w).into(),
            k_omega: rate.into(),
            limits: AccelerationLimits::new(&limits, rig.airframe.g()),
            allocation: Allocation::new(&rig.airframe),
            f_min: 4.0 * rig.rotor.f_min(k),
            f_max: 4.0 * rig.rotor.f_max(k),
            weight_n,
            f: weight_n,
        })
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.f]);
    }
}

/// A vector with its first two derivatives by time.
#[derive(Clone, Copy)]
struct Moving([Vector3<f64>; 3]);

impl Moving {
    /// Its direction, n = A/|A|.
    fn direction(&self) -> Self {
        let Self([a, da, dda]) = self;
        let rho = a.norm();
        let n = a / rho;
        let d_rho = n.dot(da);
        let dn = (da - d_rho * n) / rho;
        let dd_rho = dn.dot(da) + n.dot(dda);
        Self([n, dn, (dda - dd_rho * n - 2.0 * d_rho * dn) / rho])
    }

    fn cross(&self, other: &Self) -> Self {
        let (Self([a, da, dda]), Self([b, db, ddb])) = (self, other);
        Self([
            a.cross(b),
            da.cross(b) + a.cross(db),
            dda.cross(b) + 2.0 * da.cross(db) + a.cross(ddb),
        ])
    }
}

fn heading(reference: &Reference) -> Moving {
    let (dpsi, ddpsi) = (reference.yaw_rate_rad_s, reference.yaw_acceleration_rad_s2);
    let (sin, cos) = sin_cos(reference.yaw_rad);
    let (along, across) = (Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0));
    Moving([along, dpsi * across, ddpsi * across - dpsi * dpsi * along])
}

/// The skew part of a matrix as a vector: of S(a), a.
fn vee(m: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12)
}

/// R_d with Omega_d and its derivative, both in the frame of R_d.
struct DesiredFrame {
    r: Matrix3<f64>,
    omega: Vector3<f64>,
    d_omega: Vector3<f64>,
}

/// b3 along A, b1 as near to b1d as that allows.
fn desired(a: &Moving, b1d: &Moving) -> DesiredFrame {
    let b3 = a.direction();
    let b2 = b3.cross(b1d).direction();
    let b1 = b2.cross(&b3);
    let [r, dr, ddr] =
        [0, 1, 2].map(|order| Matrix3::from_columns(&[b1.0[order], b2.0[order], b3.0[order]]));
    // dR = R S(Omega), ddR = R (S(Omega)^2 + S(dOmega)), and a square of S has no skew part.
    DesiredFrame {
        r,
        omega: vee(&r.tr_mul(&dr)),
        d_omega: vee(&r.tr_mul(&ddr)),
    }
}

impl Geometric {
    /// f [N], and A/m [m/s^2] with its derivatives as the vehicle really moves; true where A was limited.
    fn thrust(
        &self,
        state: &Measured,
        reference: &Reference,
        r: &Matrix3<f64>,
    ) -> (f64, Moving, bool) {
        let (m, g) = (self.rig.airframe.m(), self.rig.airframe.g());
        let drag = self.rig.airframe.k_t() / m;
        let [x, v] = [state.position_w_m, state.velocity_w_m_s].map(Vector3::from);
        let [x_d, v_d, dv_d, ddv_d, dddv_d] = motion(reference);
        let (e3, r3) = (Vector3::z(), r.column(2).into_owned());

        let (e_x, e_v) = (x - x_d, v - v_d);
        let (a, limited) = self
            .limits
            .limit(&(-self.k_x * e_x - self.k_v * e_v + g * e3 + dv_d + drag * v));
        let wanted = m * a.dot(&r3);
        let f = wanted.max(self.f_min).min(self.f_max);
        if limited {
            return (f, Moving([a, Vector3::zeros(), Vector3::zeros()]), true);
        }
        let dv = -g * e3 + f / m * r3 - drag * v;
        let e_a = dv - dv_d;
        let da = -self.k_x * e_v - self.k_v * e_a + ddv_d + drag * dv;
        let dr3 = r * Vector3::from(state.rate_b_rad_s).cross(&e3);
        let is_free = f == wanted;
        let df = if is_free {
            m * (da.dot(&r3) + a.dot(&dr3))
        } else {
            0.0
        };
        let ddv = (df * r3 + f * dr3) / m - drag * dv;
        let e_j = ddv - ddv_d;
        let dda = -self.k_x * e_a - self.k_v * e_j + dddv_d + drag * ddv;
        (f, Moving([a, da, dda]), false)
    }

    /// f [N], moved towards m g as far as roll and pitch of `tau` [N m] need.
    fn give_way(&self, f: f64, tau: &Vector3<f64>) -> f64 {
        let roll_pitch = Vector3::new(tau.x, tau.y, 0.0);
        let room = 4.0 * self.allocation.thrusts(0.0, &roll_pitch).amax();
        let low = (self.f_min + room).min(self.weight_n);
        let high = (self.f_max - room).max(self.weight_n);
        f.max(low).min(high)
    }
}

impl InnerLaw for Geometric {
    /// Without a measurement of this tick: no torque, and the last thrust.
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        if input.measured_age != 0 {
            return cascade::no_torque(self.f);
        }
        let (state, reference) = (&input.measured, &input.reference);
        let r = Attitude::of_wxyz(state.attitude_quaternion).rot_wb();
        let omega = Vector3::from(state.rate_b_rad_s);
        let j = Vector3::from(self.rig.airframe.i_m());
        let (f, a, limited) = self.thrust(state, reference, &r);
        let frame = desired(&a, &heading(reference));
        let r_d = frame.r;

        let e_r = 0.5 * vee(&(r_d.tr_mul(&r) - r.tr_mul(&r_d)));
        let turned = r.tr_mul(&r_d) * frame.omega;
        let d_turned = r.tr_mul(&r_d) * frame.d_omega - omega.cross(&turned);
        let e_omega = omega - turned;
        let tau = j.component_mul(
            &(d_turned - self.k_r.component_mul(&e_r) - self.k_omega.component_mul(&e_omega)),
        ) + omega.cross(&j.component_mul(&omega))
            + self.rig.airframe.k_r() * turned;

        self.f = self.give_way(f, &tau);
        let e_x = Vector3::from(state.position_w_m) - Vector3::from(reference.position_w_m);
        let psi = 0.5 * (3.0 - r_d.tr_mul(&r).trace());
        let shown = [
            e_x.norm(),
            psi,
            e_omega.x,
            e_omega.y,
            e_omega.z,
            f64::from(u8::from(limited)),
        ];
        telemetry.value[..shown.len()].copy_from_slice(&shown);
        WrenchSetpoint {
            thrust_n: self.f,
            torque_b_nm: tau.into(),
        }
    }
}
