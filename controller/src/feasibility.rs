//! What a course asks of an airframe, against what it may and can: looked at before a flight.
//!
//! The airframe is taken to fly the reference exactly. Its thrust and attitude follow from (9)-(16), and its torques
//! and rotor speeds from their derivatives, (8) and (7): the model is differentially flat. Estimates, disturbances and
//! the way back to the reference ask for more, so what is feasible here may still not be flown.

use std::fmt;

use model::allocation::Allocation;
use model::frames::RollPitch;
use model::math::atan2;
use model::rate_dynamics::Inertia;
use nalgebra::Vector3;

use crate::flatness::{Yaw, tilt, tilt_rates};
use crate::outer::thrust_acceleration;
use crate::settings::LoopSettings;
use crate::trajectory::Reference;

/// Time between two looks [s].
const STEP_S: f64 = 0.01;
/// A course is looked at for so long at the most [s]: the built-in ones do not end, and repeat themselves by then.
const LONGEST_S: f64 = 600.0;
/// Distance from where the flight begins at which a course counts as beginning with a jump [m], and yaw likewise [rad].
const JUMP: f64 = 1e-3;

/// What a course asks for too much of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Demanded {
    /// It does not begin where the airframe stands [m].
    Jump,
    /// Vertical thrust acceleration [g], above its limit.
    Climb,
    /// Vertical thrust acceleration [g], below its limit.
    Descent,
    /// Angle of the thrust from the vertical [rad].
    Tilt,
    /// Speed of a rotor [rad/s], above its limit.
    RotorAbove,
    /// Speed of a rotor [rad/s], below its limit.
    RotorBelow,
}

/// Where a course asks for more than a limit allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Of what.
    pub demanded: Demanded,
    /// When for the first time [s].
    pub first_s: f64,
    /// When the most [s].
    pub worst_s: f64,
    /// The most that is asked for.
    pub worst: f64,
    /// What is allowed, in the same unit.
    pub allowed: f64,
}

/// Where a flight begins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// Position, world frame [m].
    pub position_w_m: [f64; 3],
    /// Yaw [rad].
    pub yaw_rad: f64,
}

/// Walks a course up to `duration_s` [s] and gives what it asks too much of, for a flight that begins at `start`.
#[must_use]
pub fn excesses(settings: &LoopSettings, start: &Start, duration_s: f64) -> Vec<Excess> {
    let course = &settings.trajectory;
    let end_s = duration_s.min(LONGEST_S).min(course.end_s().unwrap_or(f64::INFINITY));
    let mut found: Vec<Excess> = Vec::new();
    let mut take = |demanded, t_s: f64, value: f64, allowed: f64, is_below: bool| {
        let over = |value: f64| if is_below { allowed - value } else { value - allowed };
        // What is not a number cannot be flown, either.
        if over(value) <= 0.0 {
            return;
        }
        match found.iter_mut().find(|excess| excess.demanded == demanded) {
            Some(excess) if over(value) > over(excess.worst) => (excess.worst_s, excess.worst) = (t_s, value),
            Some(_) => {}
            None => found.push(Excess { demanded, first_s: t_s, worst_s: t_s, worst: value, allowed }),
        }
    };
    let begin = course.reference(0.0);
    let away_m = (begin.position() - Vector3::from(start.position_w_m)).norm();
    take(Demanded::Jump, 0.0, away_m.max((begin.yaw() - start.yaw_rad).abs()), JUMP, false);
    let limits = &settings.limits;
    let looks = (end_s / STEP_S).floor() as u64;
    for i in 0..=looks {
        let t_s = i as f64 * STEP_S;
        let asked = Asked::of(&course.reference(t_s), settings);
        take(Demanded::Climb, t_s, asked.climb_g, limits.acceleration_z_max_g, false);
        take(Demanded::Descent, t_s, asked.climb_g, limits.acceleration_z_min_g, true);
        take(Demanded::Tilt, t_s, asked.tilt_rad, limits.tilt_max_rad, false);
        take(Demanded::RotorAbove, t_s, asked.fastest_rad_s, settings.rotor.max_rad_s, false);
        take(Demanded::RotorBelow, t_s, asked.slowest_rad_s, settings.rotor.min_rad_s, true);
    }
    found
}

/// What a reference asks for at an instant.
struct Asked {
    climb_g: f64,
    tilt_rad: f64,
    fastest_rad_s: f64,
    slowest_rad_s: f64,
}

impl Asked {
    fn of(reference: &Reference, settings: &LoopSettings) -> Self {
        let model = &settings.model;
        let drag = model.k_t() / model.m();
        let a = thrust_acceleration(&reference.acceleration(), &reference.velocity(), model);
        let (da, dda) =
            (reference.jerk() + drag * reference.acceleration(), reference.snap() + drag * reference.jerk());
        let yaw = Yaw::new(reference.yaw(), reference.yaw_rate(), reference.yaw_acceleration());
        let (phi, theta) = tilt(&a, &yaw);
        let rates = tilt_rates(&a, &da, &dda, &yaw);
        let (xi, dxi) = (
            Vector3::new(rates.dphi, rates.dtheta, reference.yaw_rate()),
            Vector3::new(rates.ddphi, rates.ddtheta, reference.yaw_acceleration()),
        );
        let attitude = RollPitch::of(&Vector3::new(phi, theta, reference.yaw()));
        let nu2 = attitude.body_rate(&xi);
        let dnu2 = attitude.body_rate_dot(&xi, &xi) + attitude.body_rate(&dxi);
        let inertia = Inertia::new(Vector3::from(model.i_m()));
        let tau = inertia.i_m().component_mul(&(dnu2 - inertia.coupling(&nu2))) + model.k_r() * nu2;
        let thrusts = Allocation::new(model).thrusts(model.m() * a.norm(), &tau);
        let speed = |f: f64| (f.max(0.0) / model.k()).sqrt();
        Self {
            climb_g: a.z / model.g(),
            tilt_rad: atan2(a.xy().norm(), a.z),
            fastest_rad_s: speed(thrusts.max()),
            slowest_rad_s: speed(thrusts.min()),
        }
    }
}

impl fmt::Display for Excess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { demanded, first_s, worst_s, worst, allowed } = self;
        let (what, unit, key) = match demanded {
            Demanded::Jump => {
                return write!(f, "begins with a jump: {worst:.3} m or rad away from where the flight stands at 0 s");
            }
            Demanded::Climb => ("a vertical thrust", "g", "limits.acceleration_z_max_g"),
            Demanded::Descent => ("a vertical thrust", "g", "limits.acceleration_z_min_g"),
            Demanded::Tilt => ("a tilt", "rad", "limits.tilt_max_rad"),
            Demanded::RotorAbove => ("a rotor speed", "rad/s", "rotor.max_rad_s"),
            Demanded::RotorBelow => ("a rotor speed", "rad/s", "rotor.min_rad_s"),
        };
        write!(f, "asks for {what} of {worst:.4} {unit} at {worst_s:.2} s")?;
        if first_s != worst_s {
            write!(f, ", too much from {first_s:.2} s on")?;
        }
        write!(f, "; {key} is {allowed:.4}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gains::Preset;
    use crate::trajectory::{Course, Trajectory};

    fn found(course: impl Into<Course>) -> Vec<Excess> {
        excesses(&LoopSettings::new(course, Preset::Flight), &Start::default(), 30.0)
    }

    #[test]
    fn the_built_in_trajectories_are_feasible_but_for_the_step() {
        for trajectory in Trajectory::ALL {
            let found = found(trajectory);
            if trajectory == Trajectory::Step {
                assert_eq!(found.len(), 1);
                assert_eq!(found[0].demanded, Demanded::Jump);
                assert!((found[0].worst - 3_f64.sqrt()).abs() < 1e-12, "{}", found[0]);
            } else {
                assert_eq!(found, [], "{trajectory}");
            }
        }
    }

    #[test]
    fn a_course_jumps_from_where_the_flight_begins() {
        let jumps = |trajectory, position_w_m, yaw_rad| {
            let settings = LoopSettings::new(trajectory, Preset::Flight);
            let found = excesses(&settings, &Start { position_w_m, yaw_rad }, 1.0);
            found.iter().find(|excess| excess.demanded == Demanded::Jump).map(|excess| excess.worst)
        };
        let begin = Course::of(Trajectory::Step).reference(0.0);
        assert_eq!(jumps(Trajectory::Step, begin.position().into(), begin.yaw()), None);
        assert_eq!(jumps(Trajectory::Hover, [0.0, 0.0, 3.0], 0.0), Some(3.0));
        assert_eq!(jumps(Trajectory::Hover, [0.0; 3], -0.5), Some(0.5));
    }

    #[test]
    fn what_is_too_quick_is_named_with_its_instant() {
        let hurried = found(Course::of(Trajectory::Fast).stretched(1.0, 0.5));
        let tilt = hurried.iter().find(|excess| excess.demanded == Demanded::Tilt).unwrap();
        assert!(tilt.first_s < tilt.worst_s && tilt.worst > tilt.allowed, "{tilt}");
        assert!(tilt.to_string().contains("limits.tilt_max_rad is 0.6109"), "{tilt}");
        assert!(hurried.iter().any(|excess| excess.demanded == Demanded::RotorAbove), "{hurried:?}");
    }

    #[test]
    fn a_rotor_in_hover_turns_at_the_speed_of_hover() {
        let mut settings = LoopSettings::new(Trajectory::Hover, Preset::Flight);
        let hover = settings.model.hover_speed_rad_s();
        settings.rotor.max_rad_s = 0.99 * hover;
        let found = excesses(&settings, &Start::default(), 60.0);
        let last = found.iter().find(|excess| excess.demanded == Demanded::RotorAbove).unwrap();
        assert_eq!((last.first_s, last.allowed), (0.0, 0.99 * hover));
        assert!(last.worst >= hover && last.worst < 1.2 * hover);
    }
}
