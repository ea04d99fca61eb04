//! All attitudes: conservation, the quaternion against Euler angles, loops through 90 degrees of pitch.

use std::f64::consts::{PI, TAU};

use messages::attitude::Attitude;
use messages::frames::RollPitch;
use messages::parameters::{Airframe, Parameter};
use nalgebra::{Vector3, Vector4};
use plant::integrator::{SUBSTEPS, integrate};
use plant::rigid_body::{Dynamics, Forcing, RigidBody};
use plant::rotors::{Spin, effort};
use plant::{Initial, Plant, PlantSettings};
use proptest::prelude::*;

use crate::{PERIOD_S, airframe};

/// Without drag, rotor inertia and disturbance; gravity may stay.
fn free() -> Airframe {
    use Parameter::{DisturbanceGain, RotationalDrag, RotorInertia, TranslationalDrag};
    airframe(&[
        (TranslationalDrag, 0.0),
        (RotationalDrag, 0.0),
        (RotorInertia, 0.0),
        (DisturbanceGain, 0.0),
    ])
}

fn length(attitude: &Attitude) -> f64 {
    Vector4::from(attitude.wxyz()).norm()
}

/// A Runge-Kutta step of (5) and (8) as the paper has them: Euler angles [rad] and body rates [rad/s].
fn euler_step(
    (eta2, nu2): (Vector3<f64>, Vector3<f64>),
    dynamics: &Dynamics,
    forcing: &Forcing,
    dt_s: f64,
) -> (Vector3<f64>, Vector3<f64>) {
    let rate = |(d_eta2, d_nu2): (Vector3<f64>, Vector3<f64>), dt_s: f64| {
        let (eta2, nu2) = (eta2 + d_eta2 * dt_s, nu2 + d_nu2 * dt_s);
        (
            RollPitch::of(&eta2).euler_rate(&nu2),
            dynamics.angular_acceleration(&nu2, forcing),
        )
    };
    let k1 = rate((Vector3::zeros(), Vector3::zeros()), 0.0);
    let k2 = rate(k1, dt_s / 2.0);
    let k3 = rate(k2, dt_s / 2.0);
    let k4 = rate(k3, dt_s);
    let sixth_s = dt_s / 6.0;
    (
        eta2 + (k1.0 + (k2.0 + k3.0) * 2.0 + k4.0) * sixth_s,
        nu2 + (k1.1 + (k2.1 + k3.1) * 2.0 + k4.1) * sixth_s,
    )
}

#[test]
fn a_loop_passes_90_degrees_of_pitch_without_a_jump() {
    let airframe = free();
    let spin = Spin::new(&airframe, Vector4::zeros(), Vector4::zeros());
    let start = RigidBody {
        nu2: Vector3::new(0.0, TAU, 0.0),
        ..RigidBody::default()
    };
    let (mut body, mut shown, mut steepest) = (start, Vector3::zeros(), 0.0_f64);
    for tick in 0..1000 {
        let next = integrate(&body, &airframe, &spin, tick, PERIOD_S, SUBSTEPS);
        let turned = Vector4::from(next.attitude.wxyz()) - Vector4::from(body.attitude.wxyz());
        let turned = turned.norm();
        assert!(
            (turned - PI * PERIOD_S).abs() < 1e-6,
            "tick {tick}: {turned}"
        );
        body = next;
        shown = body.attitude.euler_near(&shown);
        steepest = steepest.max(shown.y);
        assert!(shown.iter().all(|angle| angle.is_finite()), "{shown}");
        assert!(shown.y.abs() <= PI / 2.0, "{shown}");
    }
    assert!(steepest > 1.56, "{steepest}");
    // Once round, the quaternion has the other sign: it is continuous over two turns.
    let closed = Vector4::from(body.attitude.wxyz()) + Vector4::from(start.attitude.wxyz());
    assert!(closed.norm() < 1e-9, "{closed}");
    assert!((body.attitude.rot_wb() - start.attitude.rot_wb()).amax() < 1e-9);
}

#[test]
fn yaw_and_roll_are_counted_over_whole_turns() {
    for axis in [0, 2] {
        let mut initial = Initial::default();
        initial.rate_b_rad_s[axis] = 8.0;
        let mut plant = Plant::new(&PlantSettings {
            airframe: free(),
            initial,
            ..PlantSettings::default()
        });
        let angle = plant.begin(2000).measured.attitude_rad[axis];
        assert!((angle - 16.0).abs() < 1e-9, "{angle}");
    }
}

#[test]
fn a_flight_begins_in_the_attitude_of_its_settings() {
    let initial = Initial {
        attitude_rad: [170.0_f64.to_radians(), -0.4, 2.5],
        ..Initial::default()
    };
    let mut plant = Plant::new(&PlantSettings {
        initial,
        ..PlantSettings::default()
    });
    let shown = Vector3::from(plant.begin(0).measured.attitude_rad);
    assert!((shown - Vector3::from(initial.attitude_rad)).norm() < 1e-14);
    assert_eq!(plant.envelope(), Ok(()));
    let limited = PlantSettings {
        tilt_max_rad: 1.5,
        initial,
        ..PlantSettings::default()
    };
    let said = Plant::new(&limited).envelope().unwrap_err().to_string();
    let expected = "the flight left its envelope: at tick 0 the tilt is 15";
    assert!(said.starts_with(expected), "{said}");
}

proptest! {
    #[test]
    fn energy_and_momentum_are_kept_in_every_attitude(
        eta2 in prop::array::uniform3(-PI..PI),
        v in prop::array::uniform3(-5.0..5.0_f64),
        nu2 in prop::array::uniform3(-10.0..10.0_f64),
    ) {
        let airframe = free();
        let i_m = Vector3::from(airframe.i_m());
        let energy = |body: &RigidBody| {
            airframe.m() * (body.v.norm_squared() / 2.0 + airframe.g() * body.eta1.z)
                + body.nu2.component_mul(&i_m).dot(&body.nu2) / 2.0
        };
        let momentum = |body: &RigidBody| body.attitude.rot_wb() * body.nu2.component_mul(&i_m);
        let start = RigidBody {
            v: v.into(),
            attitude: Attitude::of_euler(&eta2.into()),
            nu2: nu2.into(),
            ..RigidBody::default()
        };
        let spin = Spin::new(&airframe, Vector4::zeros(), Vector4::zeros());
        let mut body = start;
        for tick in 0..500 {
            body = integrate(&body, &airframe, &spin, tick, PERIOD_S, SUBSTEPS);
            prop_assert!((length(&body.attitude) - 1.0).abs() < 1e-15);
        }
        prop_assert!((energy(&body) - energy(&start)).abs() < 1e-10);
        prop_assert!((momentum(&body) - momentum(&start)).norm() < 1e-10);
    }

    #[test]
    fn away_from_the_singularity_euler_angles_integrate_to_the_same(
        eta2 in prop::array::uniform3(-0.5..0.5_f64),
        nu2 in prop::array::uniform3(-1.0..1.0_f64),
        speeds in prop::array::uniform4(195.0..205.0_f64),
    ) {
        let airframe = airframe(&[(Parameter::DisturbanceGain, 0.0)]);
        let speeds = Vector4::from(speeds);
        let spin = Spin::new(&airframe, speeds, speeds);
        let dynamics = Dynamics::new(&airframe);
        let forcing = dynamics.forcing(&effort(&airframe, &speeds));
        let mut body = RigidBody {
            attitude: Attitude::of_euler(&eta2.into()),
            nu2: nu2.into(),
            ..RigidBody::default()
        };
        let (mut by_euler, mut shown) = ((Vector3::from(eta2), Vector3::from(nu2)), Vector3::from(eta2));
        for tick in 0..200 {
            body = integrate(&body, &airframe, &spin, tick, PERIOD_S, SUBSTEPS);
            shown = body.attitude.euler_near(&shown);
            for _ in 0..SUBSTEPS {
                by_euler = euler_step(by_euler, &dynamics, &forcing, PERIOD_S / f64::from(SUBSTEPS));
            }
            prop_assert!((by_euler.0 - shown).norm() < 1e-9, "tick {tick}: {} is not {shown}", by_euler.0);
            prop_assert!((by_euler.1 - body.nu2).norm() < 1e-12);
        }
    }

    #[test]
    fn the_whole_turn_is_the_nearest(eta2 in prop::array::uniform3(-1.5..1.5_f64), turns in -5..=5_i32) {
        let eta2 = Vector3::from(eta2);
        let last = eta2 + Vector3::new(TAU, 0.0, TAU) * f64::from(turns);
        prop_assert!((Attitude::of_euler(&eta2).euler_near(&last) - last).norm() < 1e-13);
    }
}
