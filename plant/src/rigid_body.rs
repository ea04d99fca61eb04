//! Rigid body of the quadrotor: equations (1), (3) in the form (8), and (5).
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri). This
//! file owns the accelerations and the state derivative. [`crate::rotors`] owns how thrust and torque come about.
//!
//! Differences from the paper (docs/paper.md lists them all):
//! * J2 of (5): rows 2 and 3 are derived from S(nu2) = J1^T d(J1)/dt. As printed, q would drive the yaw of level
//!   flight.
//! * f of (8) is the vector F(nu2) nu2, and row 3 of g2 is r/I_z, not T_z/I_z. Both follow from (3).
//! * h is a known function of time, h(t), not of the rates.
//! * u is only the total thrust. The body velocity is v, and I_M^-1 tau has no letter of its own.

use model::frames::{euler_rate_of_body_rate, rot_wb};
use model::parameters::Airframe;
use model::rate_dynamics::{coupling, regressor};
use nalgebra::Vector3;

/// Where the body is and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidBody {
    /// Position, world frame [m].
    pub eta1: Vector3<f64>,
    /// Velocity, world frame [m/s].
    pub v: Vector3<f64>,
    /// Roll, pitch, yaw [rad]; never wrapped, so that it stays continuous.
    pub eta2: Vector3<f64>,
    /// Body rates p, q, r [rad/s].
    pub nu2: Vector3<f64>,
}

/// Time derivative of a [`RigidBody`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidBodyRate {
    /// Velocity, world frame [m/s].
    pub d_eta1: Vector3<f64>,
    /// Acceleration, world frame [m/s^2].
    pub d_v: Vector3<f64>,
    /// Rates of roll, pitch, yaw [rad/s].
    pub d_eta2: Vector3<f64>,
    /// Angular acceleration, body frame [rad/s^2].
    pub d_nu2: Vector3<f64>,
}

/// What drives the body at an instant, however it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Forcing {
    /// What the rotors do.
    pub effort: Effort,
    /// h(t), direction of the periodic disturbance, without unit.
    pub h: Vector3<f64>,
}

/// What the rotors do to the body at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Total thrust along body z, u [N].
    pub u: f64,
    /// Torque about body x, y, z, tau [N m].
    pub tau: Vector3<f64>,
    /// Net rotor speed of (4), Om [rad/s].
    pub om: f64,
}

/// (1): acceleration in the world frame [m/s^2], of attitude `eta2` [rad], velocity `v` [m/s, world], thrust `u` [N].
#[must_use]
pub fn linear_acceleration(airframe: &Airframe, eta2: &Vector3<f64>, v: &Vector3<f64>, u: f64) -> Vector3<f64> {
    let (m, g, k_t) = (airframe.m(), airframe.g(), airframe.k_t());
    let z_e = Vector3::z();
    -g * z_e + rot_wb(eta2).column(2) * (u / m) - v * (k_t / m)
}

/// (8), which is (3) solved for d(nu2): angular acceleration in the body frame [rad/s^2], of rates `nu2` [rad/s], net
/// rotor speed `om` [rad/s], direction of the disturbance `h` and torque `tau` [N m].
#[must_use]
pub fn angular_acceleration(
    airframe: &Airframe,
    nu2: &Vector3<f64>,
    om: f64,
    h: &Vector3<f64>,
    tau: &Vector3<f64>,
) -> Vector3<f64> {
    let i_m = Vector3::from(airframe.i_m());
    let theta = Vector3::new(airframe.i_r(), airframe.k_r(), airframe.delta());
    coupling(nu2, &i_m) + regressor(nu2, om, h, &i_m) * theta + tau.component_div(&i_m)
}

impl RigidBody {
    /// (1), (5), (8): the derivative under a forcing. Singular at a pitch of +-90 degrees.
    #[must_use]
    // Part of the integrator's loop, so that quotients of parameters are computed once a tick and not 16 times.
    #[inline(always)]
    pub fn rate(&self, airframe: &Airframe, forcing: &Forcing) -> RigidBodyRate {
        let Self { eta2, v, nu2, .. } = self;
        let Forcing { effort, h } = forcing;
        RigidBodyRate {
            d_eta1: *v,
            d_v: linear_acceleration(airframe, eta2, v, effort.u),
            d_eta2: euler_rate_of_body_rate(eta2) * nu2,
            d_nu2: angular_acceleration(airframe, nu2, effort.om, h, &effort.tau),
        }
    }

    /// The body moved along `rate` for `dt_s` [s]: one Euler step, the building block of the integrator.
    #[must_use]
    pub fn along(&self, rate: &RigidBodyRate, dt_s: f64) -> Self {
        Self {
            eta1: self.eta1 + rate.d_eta1 * dt_s,
            v: self.v + rate.d_v * dt_s,
            eta2: self.eta2 + rate.d_eta2 * dt_s,
            nu2: self.nu2 + rate.d_nu2 * dt_s,
        }
    }

    /// Whether every component is a finite number.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        [self.eta1, self.v, self.eta2, self.nu2].iter().flatten().all(|x| x.is_finite())
    }
}
