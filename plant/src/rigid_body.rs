//! Rigid body of the quadrotor: equations (1), (3) in the form (8), and the attitude.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri). This
//! file owns the accelerations and the state derivative. [`crate::rotors`] owns how thrust and torque come about.
//!
//! Differences from the paper (docs/paper.md lists them all):
//! * (5) is replaced by q_dot = 1/2 q (x) (0, nu2) of a unit quaternion: the same motion, without the singularity of J2.
//! * f of (8) is the vector F(nu2) nu2, and row 3 of g2 is r/I_z, not T_z/I_z. Both follow from (3).
//! * h is a known function of time, h(t), not of the rates.
//! * The drag of (1) acts on the velocity relative to the air, which stands still in the paper.
//! * u is only the total thrust. The body velocity is v, and I_M^-1 tau has no letter of its own.

use messages::attitude::Attitude;
use messages::math::atan2;
use messages::parameters::Airframe;
use messages::rate_dynamics::Inertia;
use messages::vectors::numbers;
use nalgebra::{Vector2, Vector3, Vector4};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidBody {
    /// Position, world frame [m].
    pub eta1: Vector3<f64>,
    /// Velocity, world frame [m/s].
    pub v: Vector3<f64>,
    pub attitude: Attitude,
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
    /// Derivative of the quaternion, w, x, y, z [1/s].
    pub d_attitude: Vector4<f64>,
    /// Angular acceleration, body frame [rad/s^2].
    pub d_nu2: Vector3<f64>,
}

/// What drives the body at an instant, however it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Forcing {
    /// Thrust over mass, u/m [m/s^2].
    pub lift: f64,
    /// I_M^-1 tau + h(t) delta [rad/s^2].
    pub push: Vector3<f64>,
    /// Net rotor speed of (4), Om [rad/s].
    pub om: f64,
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

/// (1) and (8) with the parameters of one airframe: their quotients, which hold for a whole tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dynamics {
    /// Gravity, g [m/s^2].
    g: f64,
    /// 1/m [1/kg].
    per_mass: f64,
    /// k_t/m [1/s].
    drag: f64,
    /// Velocity of the air, world frame [m/s].
    wind: Vector3<f64>,
    inertia: Inertia,
    /// I_M^-1 I_R of x and y, without unit.
    gyroscopic: Vector2<f64>,
    /// I_M^-1 k_r [1/s].
    rate_drag: Vector3<f64>,
    /// delta [rad/s^2].
    delta: f64,
}

numbers!(RigidBody: eta1, v, attitude, nu2);
numbers!(Forcing: lift, push, om);
numbers!(Dynamics: g, per_mass, drag, wind, inertia, gyroscopic, rate_drag, delta);

impl Dynamics {
    #[inline]
    pub fn new(airframe: &Airframe) -> Self {
        let (m, i_m) = (airframe.m(), Vector3::from(airframe.i_m()));
        let inertia = Inertia::new(i_m);
        let per_inertia = inertia.acceleration(&Vector3::repeat(1.0));
        Self {
            g: airframe.g(),
            per_mass: 1.0 / m,
            drag: airframe.k_t() / m,
            wind: airframe.wind().into(),
            inertia,
            gyroscopic: airframe.i_r() * per_inertia.xy(),
            rate_drag: per_inertia * airframe.k_r(),
            delta: airframe.delta(),
        }
    }

    /// Adds a gust [m/s, world] to the mean wind of the airframe's parameters.
    #[inline]
    pub fn gust(&mut self, airframe: &Airframe, gust: &Vector3<f64>) {
        self.wind = Vector3::from(airframe.wind()) + gust;
    }

    /// What the rotors do, without the disturbance.
    #[inline]
    pub fn forcing(&self, effort: &Effort) -> Forcing {
        let Effort { u, tau, om } = effort;
        Forcing {
            lift: u * self.per_mass,
            push: self.inertia.acceleration(tau),
            om: *om,
        }
    }

    /// The same with the disturbance; `h` is h(t), without unit.
    #[inline(always)]
    pub fn disturbed(&self, forcing: &Forcing, h: &Vector3<f64>) -> Forcing {
        Forcing {
            push: forcing.push + h * self.delta,
            ..*forcing
        }
    }

    /// (1): acceleration in the world frame [m/s^2] at an attitude and velocity `v` [m/s, world].
    #[inline(always)]
    pub fn linear_acceleration(
        &self,
        attitude: &Attitude,
        v: &Vector3<f64>,
        forcing: &Forcing,
    ) -> Vector3<f64> {
        // -0 changes nothing that is added to it, so two additions of three are none.
        Vector3::new(-0.0, -0.0, -self.g) + attitude.z_b_in_w() * forcing.lift
            - (v - self.wind) * self.drag
    }

    /// (8), which is (3) solved for d(nu2): angular acceleration in the body frame [rad/s^2] at rates `nu2` [rad/s].
    #[inline(always)]
    pub fn angular_acceleration(&self, nu2: &Vector3<f64>, forcing: &Forcing) -> Vector3<f64> {
        let (i_r_x, i_r_y) = (self.gyroscopic.x, self.gyroscopic.y);
        let g1_i_r = Vector3::new(-i_r_x * forcing.om * nu2.y, i_r_y * forcing.om * nu2.x, 0.0);
        let g2_k_r = -self.rate_drag.component_mul(nu2);
        self.inertia.coupling(nu2) + g1_i_r + g2_k_r + forcing.push
    }

    /// Specific force in the body frame [m/s^2], under thrust `u` [N] and while the ground accelerates the body by
    /// `pushed_w` [m/s^2, world]: the acceleration less gravity, as an accelerometer in the centre of mass feels it.
    #[inline]
    pub fn specific_force(
        &self,
        body: &RigidBody,
        u: f64,
        pushed_w: &Vector3<f64>,
    ) -> Vector3<f64> {
        Vector3::z() * (u * self.per_mass)
            + body
                .attitude
                .to_body(&(pushed_w - (body.v - self.wind) * self.drag))
    }
}

impl RigidBody {
    /// (1), (8) and that of the quaternion: the derivative under a forcing.
    // Part of the integrator's loop: called, it would hand 25 numbers through memory, 16 times a tick.
    #[inline(always)]
    pub fn rate(&self, dynamics: &Dynamics, forcing: &Forcing) -> RigidBodyRate {
        let Self {
            attitude, v, nu2, ..
        } = self;
        RigidBodyRate {
            d_eta1: *v,
            d_v: dynamics.linear_acceleration(attitude, v, forcing),
            d_attitude: attitude.rate(nu2),
            d_nu2: dynamics.angular_acceleration(nu2, forcing),
        }
    }

    /// The body moved along `rate` for `dt_s` [s]: one Euler step, the building block of the integrator.
    #[inline(always)]
    pub fn along(&self, rate: &RigidBodyRate, dt_s: f64) -> Self {
        Self {
            eta1: self.eta1 + rate.d_eta1 * dt_s,
            v: self.v + rate.d_v * dt_s,
            attitude: self.attitude.along(&rate.d_attitude, dt_s),
            nu2: self.nu2 + rate.d_nu2 * dt_s,
        }
    }

    /// Angle between body z and the vertical [rad]: 0 level, pi upside down.
    pub fn tilt_rad(&self) -> f64 {
        let z_b = self.attitude.z_b_in_w();
        atan2((z_b.x * z_b.x + z_b.y * z_b.y).sqrt(), z_b.z)
    }

    /// Whether every component is a finite number.
    pub fn is_finite(&self) -> bool {
        let attitude = self.attitude.wxyz();
        [self.eta1, self.v, self.nu2]
            .iter()
            .flatten()
            .chain(&attitude)
            .all(|x| x.is_finite())
    }
}
