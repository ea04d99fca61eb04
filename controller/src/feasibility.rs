//! What a course asks of an airframe, against what it may and can: looked at before a flight.
//!
//! The airframe is taken to fly the reference exactly. Its thrust and attitude follow from (9)-(16), and its torques
//! and rotor speeds from their derivatives, (8) and (7): the model is differentially flat. Estimates, disturbances and
//! the way back to the reference ask for more, so what is feasible here may still not be flown.

use std::fmt;

use control_api::law::Rig;
use messages::allocation::Allocation;
use messages::content::Reference;
use messages::frames::{RollPitch, wrap};
use messages::math::atan2;
use messages::parameters::Airframe;
use messages::rate_dynamics::Inertia;
use messages::role::Role;
use nalgebra::Vector3;

use crate::flatness::{Yaw, along_reference, tilt, tilt_rates};
use crate::limits::Limits;
use crate::trajectory::ScaledTrajectory;

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
    /// Height [m], below the ground.
    Ground,
    /// Speed of a rotor [rad/s], above its limit.
    RotorAbove,
    /// Speed of a rotor [rad/s], below its limit.
    RotorBelow,
}

/// Where a course asks for more than a limit allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    pub demanded: Demanded,
    pub first_s: f64,
    pub worst_s: f64,
    pub worst: f64,
    /// What is allowed, in the same unit.
    pub allowed: f64,
    /// The role whose law has the limit, where a law has it.
    pub limited_by: Option<Role>,
}

/// Where a flight begins, and the ground below it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    pub position_w_m: [f64; 3],
    pub yaw_rad: f64,
    pub ground_z_m: f64,
}

/// Walks a course up to `duration_s` [s] from `start` on and gives what it asks too much of: of the rotors, and of the
/// law that has limits of the thrust acceleration, if there is one.
pub fn excesses(
    course: &ScaledTrajectory,
    rig: &Rig,
    limits: Option<(Role, Limits)>,
    start: &Start,
    duration_s: f64,
) -> Vec<Excess> {
    let limited_by = limits.map(|(role, _)| role);
    let end_s = duration_s
        .min(LONGEST_S)
        .min(course.end_s().unwrap_or(f64::INFINITY));
    let mut found: Vec<Excess> = Vec::new();
    let mut look = |t_s: f64, demanded: Demanded, value: f64, allowed: f64| {
        let sign = match demanded {
            Demanded::Descent | Demanded::RotorBelow | Demanded::Ground => -1.0,
            _ => 1.0,
        };
        let over = |value: f64| sign * (value - allowed);
        // What is not a number cannot be flown, either.
        if over(value) <= 0.0 {
            return;
        }
        match found.iter_mut().find(|excess| excess.demanded == demanded) {
            Some(excess) if over(value) > over(excess.worst) => {
                (excess.worst_s, excess.worst) = (t_s, value)
            }
            Some(_) => {}
            None => found.push(Excess {
                demanded,
                first_s: t_s,
                worst_s: t_s,
                worst: value,
                allowed,
                limited_by,
            }),
        }
    };
    let begin = course.reference(0.0);
    let away_m = (Vector3::from(begin.position_w_m) - Vector3::from(start.position_w_m)).norm();
    let jump = away_m.max(wrap(begin.yaw_rad - start.yaw_rad).abs());
    look(0.0, Demanded::Jump, jump, JUMP);
    let looks = (end_s / STEP_S).floor() as u64;
    for i in 0..=looks {
        let t_s = i as f64 * STEP_S;
        let reference = course.reference(t_s);
        let demand = Demand::of(&reference, &rig.airframe);
        let [.., z_m] = reference.position_w_m;
        if z_m < start.ground_z_m - JUMP {
            look(t_s, Demanded::Ground, z_m, start.ground_z_m);
        }
        if let Some((_, limits)) = limits {
            // Without gravity, a limit in its multiples is none.
            if let Some(climb_g) = demand.climb_g {
                look(t_s, Demanded::Climb, climb_g, limits.acceleration_z_max_g);
                look(t_s, Demanded::Descent, climb_g, limits.acceleration_z_min_g);
            }
            look(t_s, Demanded::Tilt, demand.tilt_rad, limits.tilt_max_rad);
        }
        look(
            t_s,
            Demanded::RotorAbove,
            demand.fastest_rad_s,
            rig.rotor.max_rad_s,
        );
        look(
            t_s,
            Demanded::RotorBelow,
            demand.slowest_rad_s,
            rig.rotor.min_rad_s,
        );
    }
    found
}

/// What a reference asks for at an instant.
struct Demand {
    climb_g: Option<f64>,
    tilt_rad: f64,
    fastest_rad_s: f64,
    slowest_rad_s: f64,
}

impl Demand {
    fn of(reference: &Reference, model: &Airframe) -> Self {
        let [a, da, dda] = along_reference(reference, model.g(), model.k_t() / model.m());
        let yaw = Yaw::of(reference);
        let (phi, theta) = tilt(&a, &yaw);
        let rates = tilt_rates(&a, &da, &dda, &yaw);
        let (xi, dxi) = (
            Vector3::new(rates.dphi, rates.dtheta, yaw.dpsi),
            Vector3::new(rates.ddphi, rates.ddtheta, yaw.ddpsi),
        );
        let attitude = RollPitch::of(&Vector3::new(phi, theta, reference.yaw_rad));
        let nu2 = attitude.body_rate(&xi);
        let dnu2 = attitude.body_rate_dot(&xi, &xi) + attitude.body_rate(&dxi);
        let inertia = Inertia::new(Vector3::from(model.i_m()));
        let mut tau = inertia
            .i_m()
            .component_mul(&(dnu2 - inertia.coupling(&nu2)))
            + model.k_r() * nu2;
        if model.d() == 0.0 {
            // No speed of the rotors gives a yaw torque then, and none is asked of them.
            tau.z = 0.0;
        }
        let thrusts = Allocation::new(model).thrusts(model.m() * a.norm(), &tau);
        let speed = |f: f64| (f.max(0.0) / model.k()).sqrt();
        Self {
            climb_g: (model.g() > 0.0).then(|| a.z / model.g()),
            tilt_rad: atan2(a.xy().norm(), a.z),
            fastest_rad_s: speed(thrusts.max()),
            slowest_rad_s: speed(thrusts.min()),
        }
    }
}

impl fmt::Display for Excess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (demanded, worst, allowed) = (self.demanded, self.worst, self.allowed);
        let (first_s, worst_s) = (self.first_s, self.worst_s);
        let (what, unit, key) = match demanded {
            Demanded::Jump => {
                return write!(
                    f,
                    "begins {worst:.3} m (or rad of yaw) away from the initial state"
                );
            }
            Demanded::Climb => ("a vertical thrust", "g", "acceleration_z_max_g"),
            Demanded::Descent => ("a vertical thrust", "g", "acceleration_z_min_g"),
            Demanded::Tilt => ("a tilt", "rad", "tilt_max_rad"),
            Demanded::Ground => ("a height", "m", "flight.ground_z_m"),
            Demanded::RotorAbove => ("a rotor speed", "rad/s", "rotor.max_rad_s"),
            Demanded::RotorBelow => ("a rotor speed", "rad/s", "rotor.min_rad_s"),
        };
        write!(f, "asks for {what} of {worst:.4} {unit} at {worst_s:.2} s")?;
        if first_s != worst_s {
            write!(f, ", out of range from {first_s:.2} s on")?;
        }
        match (demanded, self.limited_by) {
            (Demanded::Climb | Demanded::Descent | Demanded::Tilt, Some(role)) => {
                write!(f, "; {role}.{key} is {allowed:.4}")
            }
            _ => write!(f, "; {key} is {allowed:.4}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::Pd;
    use crate::trajectory::Trajectory;
    use control_api::description::Settings;
    use control_api::law::Law as _;

    fn found(course: ScaledTrajectory) -> Vec<Excess> {
        let limits = Limits::of(&Pd::DESCRIPTION, &Settings::default()).unwrap();
        let limits = Some((Role::Outer, limits));
        excesses(&course, &Rig::default(), limits, &Start::default(), 30.0)
    }

    fn first(found: &[Excess], demanded: Demanded) -> Option<&Excess> {
        found.iter().find(|excess| excess.demanded == demanded)
    }

    #[test]
    fn the_built_in_trajectories_are_feasible_but_for_the_step() {
        for trajectory in Trajectory::ALL {
            match found(ScaledTrajectory::of(trajectory)).as_slice() {
                [jump] if trajectory == Trajectory::Step => {
                    assert_eq!(jump.demanded, Demanded::Jump);
                    assert!((jump.worst - 3_f64.sqrt()).abs() < 1e-12, "{jump}");
                }
                found => assert_eq!(found, [], "{trajectory}"),
            }
        }
    }

    #[test]
    fn a_course_jumps_from_where_the_flight_begins() {
        let jump = |trajectory, position_w_m, yaw_rad| {
            let start = Start {
                position_w_m,
                yaw_rad,
                ..Start::default()
            };
            let course = ScaledTrajectory::of(trajectory);
            let found = excesses(&course, &Rig::default(), None, &start, 1.0);
            first(&found, Demanded::Jump).map(|excess| excess.worst)
        };
        let begin = ScaledTrajectory::of(Trajectory::Step).reference(0.0);
        let (position, yaw) = (begin.position_w_m, begin.yaw_rad);
        assert_eq!(jump(Trajectory::Step, position, yaw), None);
        assert_eq!(jump(Trajectory::Hover, [0.0, 0.0, 3.0], 0.0), Some(3.0));
        assert_eq!(jump(Trajectory::Hover, [0.0; 3], -0.5), Some(0.5));
    }

    #[test]
    fn what_is_too_quick_is_named_with_its_instant() {
        let hurried = found(ScaledTrajectory::of(Trajectory::Fast).stretched(1.0, 0.5));
        let tilt = first(&hurried, Demanded::Tilt).unwrap();
        assert!(
            tilt.first_s < tilt.worst_s && tilt.worst > tilt.allowed,
            "{tilt}"
        );
        assert!(
            tilt.to_string().contains("outer.tilt_max_rad is 0.6109"),
            "{tilt}"
        );
        assert!(
            first(&hurried, Demanded::RotorAbove).is_some(),
            "{hurried:?}"
        );
    }

    #[test]
    fn a_rotor_in_hover_turns_at_the_speed_of_hover() {
        let mut rig = Rig::default();
        let hover = rig.airframe.hover_speed_rad_s();
        rig.rotor.max_rad_s = 0.99 * hover;
        let found = excesses(
            &ScaledTrajectory::of(Trajectory::Hover),
            &rig,
            None,
            &Start::default(),
            60.0,
        );
        let above = first(&found, Demanded::RotorAbove).unwrap();
        assert_eq!((above.first_s, above.allowed), (0.0, 0.99 * hover));
        assert!(above.worst >= hover && above.worst < 1.2 * hover);
    }

    #[test]
    fn a_start_on_another_turn_of_yaw_is_no_jump() {
        let start = Start {
            yaw_rad: 2.0 * std::f64::consts::TAU,
            ..Start::default()
        };
        let hover = ScaledTrajectory::of(Trajectory::Hover);
        assert_eq!(excesses(&hover, &Rig::default(), None, &start, 1.0), []);
    }
}
