//! From a thrust acceleration to the attitude that gives it, with two derivatives.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (13)-(16). Differences from the paper: (13) and (14) are arcsines of a component *divided by* the norm, written with
//! atan2. As printed, multiplied by the norm, they have no value above 0.10 m/s^2. The derivatives are not in the
//! paper, which feeds none forward; they follow from (13) and (14) along the reference.

use messages::content::{Desired, Reference};
use messages::math::{atan2, sin_cos};
use nalgebra::Vector3;

/// Yaw along the reference: psi_d [rad], dpsi_d [rad/s], ddpsi_d [rad/s^2].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Yaw {
    sin: f64,
    cos: f64,
    /// dpsi_d [rad/s].
    pub dpsi: f64,
    /// ddpsi_d [rad/s^2].
    pub ddpsi: f64,
}

impl Yaw {
    /// That of a reference.
    pub fn of(reference: &Reference) -> Self {
        Self::new(
            reference.yaw_rad,
            reference.yaw_rate_rad_s,
            reference.yaw_acceleration_rad_s2,
        )
    }

    /// At psi_d [rad], with its derivatives dpsi_d [rad/s] and ddpsi_d [rad/s^2].
    pub fn new(psi: f64, dpsi: f64, ddpsi: f64) -> Self {
        let (sin, cos) = sin_cos(psi);
        Self {
            sin,
            cos,
            dpsi,
            ddpsi,
        }
    }

    fn along(&self, v: &Vector3<f64>) -> f64 {
        v.x * self.cos + v.y * self.sin
    }

    fn across(&self, v: &Vector3<f64>) -> f64 {
        v.x * self.sin - v.y * self.cos
    }
}

/// Derivatives of roll and pitch along the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TiltRates {
    /// dphi_d [rad/s].
    pub dphi: f64,
    /// dtheta_d [rad/s].
    pub dtheta: f64,
    /// ddphi_d [rad/s^2].
    pub ddphi: f64,
    /// ddtheta_d [rad/s^2].
    pub ddtheta: f64,
}

/// (13), (14): roll and pitch [rad] that point the thrust along `a` [m/s^2, world frame] at a yaw.
///
/// `a` is the acceleration that the thrust gives, gravity and drag included; its z must be above 0.
pub fn tilt(a: &Vector3<f64>, yaw: &Yaw) -> (f64, f64) {
    let (s, c) = (yaw.across(a), yaw.along(a));
    (atan2(s, (c * c + a.z * a.z).sqrt()), atan2(c, a.z))
}

/// First and second derivatives of [`tilt`] where `a` [m/s^2] changes by `da` [m/s^3] and `dda` [m/s^4].
pub fn tilt_rates(a: &Vector3<f64>, da: &Vector3<f64>, dda: &Vector3<f64>, yaw: &Yaw) -> TiltRates {
    let &Yaw { dpsi, ddpsi, .. } = yaw;
    let (across, along) = (|v| yaw.across(v), |v| yaw.along(v));
    let (s, c) = (across(a), along(a));
    let ds = across(da) + dpsi * c;
    let dc = along(da) - dpsi * s;
    let dds = across(dda) + dpsi * along(da) + ddpsi * c + dpsi * dc;
    let ddc = along(dda) - dpsi * across(da) - ddpsi * s - dpsi * ds;

    let q = c * c + a.z * a.z;
    let dq = 2.0 * (c * dc + a.z * da.z);
    let ddq = 2.0 * (dc * dc + c * ddc + da.z * da.z + a.z * dda.z);
    let rho = q.sqrt();
    let n = s * s + q;
    let (per_q, per_n, per_2rho) = (1.0 / q, 1.0 / n, 0.5 / rho);
    let drho = dq * per_2rho;
    let ddrho = per_2rho * (ddq - 0.5 * dq * dq * per_q);

    let dtheta = (dc * a.z - c * da.z) * per_q;
    let dphi = (ds * rho - s * drho) * per_n;
    TiltRates {
        dphi,
        dtheta,
        ddphi: per_n * (dds * rho - s * ddrho - dphi * 2.0 * (s * ds + rho * drho)),
        ddtheta: per_q * (ddc * a.z - c * dda.z - dtheta * dq),
    }
}

/// (10): acceleration that the thrust must give for the airframe to accelerate by `wanted` at `velocity`, under gravity
/// `g` [m/s^2] and drag k_t/m [1/s].
///
/// All in the world frame, [m/s^2] and [m/s].
pub fn thrust_acceleration(
    wanted: &Vector3<f64>,
    velocity: &Vector3<f64>,
    g: f64,
    drag: f64,
) -> Vector3<f64> {
    wanted + g * Vector3::z() + drag * velocity
}

/// Position of a reference with its four derivatives, world frame [m, m/s, m/s^2, m/s^3, m/s^4].
pub fn motion(reference: &Reference) -> [Vector3<f64>; 5] {
    [
        reference.position_w_m,
        reference.velocity_w_m_s,
        reference.acceleration_w_m_s2,
        reference.jerk_w_m_s3,
        reference.snap_w_m_s4,
    ]
    .map(Vector3::from)
}

/// Thrust acceleration of an airframe that flies the reference exactly, with two derivatives.
pub fn along_reference(reference: &Reference, g: f64, drag: f64) -> [Vector3<f64>; 3] {
    let [_, v, dv, ddv, dddv] = motion(reference);
    let a = thrust_acceleration(&dv, &v, g, drag);
    [a, ddv + drag * dv, dddv + drag * ddv]
}

/// Attitude that points the thrust along `a`, with derivatives along the reference, which are 0 where `a` is limited.
pub fn desired(
    thrust_n: f64,
    (a, limited): (&Vector3<f64>, bool),
    reference: &Reference,
    g: f64,
    drag: f64,
) -> Desired {
    let yaw = Yaw::of(reference);
    let (phi_d, theta_d) = tilt(a, &yaw);
    let ahead = if limited {
        TiltRates::default()
    } else {
        let [a, da, dda] = along_reference(reference, g, drag);
        tilt_rates(&a, &da, &dda, &yaw)
    };
    Desired {
        thrust_n,
        attitude_rad: [phi_d, theta_d, reference.yaw_rad],
        attitude_rate_rad_s: [ahead.dphi, ahead.dtheta, yaw.dpsi],
        attitude_acceleration_rad_s2: [ahead.ddphi, ahead.ddtheta, yaw.ddpsi],
        limited: u64::from(limited),
    }
}
