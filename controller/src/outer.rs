//! The outer loop: from position error to total thrust and wanted attitude.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (9)-(16). Differences from the paper:
//! * The right side of (10) is 0.
//! * The drag (k_t/m) v stands in all three components, with the measured v, so that (10) holds exactly.
//! * Acceleration and thrust are limited; the paper's are not.
//! * The derivatives of roll and pitch are fed forward along the reference ([`crate::flatness`]).

use law::OuterLaw;
use model::frames::RollPitch;
use model::limits::RotorLimits;
use model::math::tan;
use model::messages::{Dated, Setpoint, State};
use model::parameters::Airframe;
use nalgebra::Vector3;

use crate::flatness::{TiltRates, Yaw, tilt, tilt_rates};
use crate::settings::{Limits, LoopSettings};
use crate::trajectory::Reference;

/// The outer loop. It keeps nothing from one tick to the next.
#[derive(Clone, Debug)]
pub struct OuterLoop {
    settings: LoopSettings,
    limits: AccelerationLimits,
}

impl OuterLoop {
    /// A loop for settings that passed [`Settings::check`].
    #[must_use]
    pub fn new(settings: &LoopSettings) -> Self {
        Self { settings: *settings, limits: AccelerationLimits::new(&settings.limits, settings.model.g()) }
    }
}

impl OuterLaw for OuterLoop {
    /// Set-point of a tick, or nothing where the state is not of this tick: the inner loop then holds the last.
    fn tick(&mut self, tick: u64, state: &Dated<State>) -> Option<Setpoint> {
        if state.tick != tick {
            return None;
        }
        let LoopSettings { period_s, trajectory, gains, rotor, model, .. } = &self.settings;
        let reference = trajectory.reference(tick as f64 * period_s);
        let position = Vector3::from(state.content.position_w_m);
        let velocity = Vector3::from(state.content.velocity_w_m_s);
        let eta2 = Vector3::from(state.content.attitude_rad);

        let wanted = reference.acceleration()
            + gains.velocity_1_s * (reference.velocity() - velocity)
            + gains.position_1_s2 * (reference.position() - position);
        let (a, limited) = self.limits.limit(&thrust_acceleration(&wanted, &velocity, model));
        let yaw = Yaw::new(reference.yaw(), reference.yaw_rate(), reference.yaw_acceleration());
        let (phi_d, theta_d) = tilt(&a, &yaw);
        let ahead = if limited {
            TiltRates { dphi: 0.0, dtheta: 0.0, ddphi: 0.0, ddtheta: 0.0 }
        } else {
            reference_tilt_rates(&reference, &yaw, model)
        };
        Some(Setpoint {
            thrust_n: limit_thrust(thrust(&a, &eta2, model), rotor, model),
            attitude_rad: [phi_d, theta_d, reference.yaw()],
            attitude_rate_rad_s: [ahead.dphi, ahead.dtheta, reference.yaw_rate()],
            attitude_acceleration_rad_s2: [ahead.ddphi, ahead.ddtheta, reference.yaw_acceleration()],
            limited: u64::from(limited),
            reference_position_w_m: reference.position().into(),
            reference_yaw_rad: reference.yaw(),
        })
    }
}

/// (10): acceleration that the thrust must give for the airframe to accelerate by `wanted` at `velocity`.
///
/// All in the world frame, [m/s^2] and [m/s].
#[must_use]
pub fn thrust_acceleration(wanted: &Vector3<f64>, velocity: &Vector3<f64>, model: &Airframe) -> Vector3<f64> {
    wanted + model.g() * Vector3::z() + model.k_t() / model.m() * velocity
}

/// Bounds of the thrust acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelerationLimits {
    /// Of its vertical part [m/s^2].
    z_min: f64,
    z_max: f64,
    /// Tangent of the largest tilt.
    tilt_max: f64,
}

impl AccelerationLimits {
    /// Those of the settings, where gravity is `g` [m/s^2].
    #[must_use]
    pub fn new(limits: &Limits, g: f64) -> Self {
        let Limits { acceleration_z_min_g, acceleration_z_max_g, tilt_max_rad } = *limits;
        Self { z_min: acceleration_z_min_g * g, z_max: acceleration_z_max_g * g, tilt_max: tan(tilt_max_rad) }
    }

    /// Keeps a thrust acceleration [m/s^2, world frame] inside the limits; true where one of them was active.
    ///
    /// The vertical part is limited first, then the tilt, by scaling the horizontal part: height before position.
    #[must_use]
    pub fn limit(&self, a: &Vector3<f64>) -> (Vector3<f64>, bool) {
        let z = a.z.clamp(self.z_min, self.z_max);
        let horizontal = a.xy().norm();
        let allowed = z * self.tilt_max;
        let scale = if horizontal > allowed { allowed / horizontal } else { 1.0 };
        let limited = z != a.z || horizontal > allowed;
        (Vector3::new(scale * a.x, scale * a.y, z), limited)
    }
}

/// (15), (16): total thrust u [N], the part of m `a` along the body's z axis at the measured attitude [rad].
#[must_use]
pub fn thrust(a: &Vector3<f64>, eta2: &Vector3<f64>, model: &Airframe) -> f64 {
    model.m() * a.dot(&RollPitch::of(eta2).rot_wb(eta2.z).column(2))
}

fn limit_thrust(u: f64, rotor: &RotorLimits, model: &Airframe) -> f64 {
    let k = model.k();
    u.clamp(4.0 * rotor.f_min(k), 4.0 * rotor.f_max(k))
}

/// Derivatives of roll and pitch for an airframe that flies the reference exactly.
fn reference_tilt_rates(reference: &Reference, yaw: &Yaw, model: &Airframe) -> TiltRates {
    let drag = model.k_t() / model.m();
    let a = thrust_acceleration(&reference.acceleration(), &reference.velocity(), model);
    let da = reference.jerk() + drag * reference.acceleration();
    let dda = reference.snap() + drag * reference.jerk();
    tilt_rates(&a, &da, &dda, yaw)
}
