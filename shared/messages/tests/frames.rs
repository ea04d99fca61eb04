//! What must hold for frames and angles at every attitude, not only in test cases.

use std::f64::consts::{PI, TAU};

use messages::attitude::Attitude;
use messages::frames::{RollPitch, quaternion_wb, wrap};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;

prop_compose! {
    fn attitude()(phi in -PI..PI, theta in -1.5..1.5, psi in -PI..PI) -> Vector3<f64> {
        Vector3::new(phi, theta, psi)
    }
}

fn matrix(of: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::z()].map(|unit| of(&unit)))
}

pub fn rot_wb(eta2: &Vector3<f64>) -> Matrix3<f64> {
    RollPitch::of(eta2).rot_wb(eta2.z)
}

pub fn j2(eta2: &Vector3<f64>) -> Matrix3<f64> {
    matrix(|nu2| RollPitch::of(eta2).euler_rate(nu2))
}

pub fn w(eta2: &Vector3<f64>) -> Matrix3<f64> {
    matrix(|xi| RollPitch::of(eta2).body_rate(xi))
}

proptest! {
    #[test]
    fn the_quaternion_is_the_same_rotation(eta2 in attitude()) {
        let quaternion = UnitQuaternion::new_unchecked(Quaternion::from(quaternion_wb(&eta2)));
        prop_assert!((quaternion.to_rotation_matrix().matrix() - rot_wb(&eta2)).amax() < 1e-14);
    }

    #[test]
    fn rotations_compose_and_invert_and_the_shortest_one_leads_between_vectors(a in attitude(), b in attitude()) {
        let [p, q] = [a, b].map(|eta2| Attitude::of_euler(&eta2));
        prop_assert!((p.rot_wb() - rot_wb(&a)).amax() < 1e-14);
        prop_assert!((p.times(&q).rot_wb() - p.rot_wb() * q.rot_wb()).amax() < 1e-14);
        prop_assert!(p.inverse().times(&p).vector().amax() < 1e-14);
        prop_assert!(p.short_way().scalar() >= 0.0 && (p.short_way().rot_wb() - p.rot_wb()).amax() < 1e-15);
        let (from, to) = (p.z_b_in_w(), q.z_b_in_w());
        if let Some(turn) = Attitude::between(&from, &to) {
            prop_assert!((turn.to_world(&from) - to).amax() < 1e-9);
            prop_assert!((turn.to_world(&from.cross(&to)) - from.cross(&to)).amax() < 1e-9);
        }
        prop_assert_eq!(Attitude::between(&from, &-from), None);
    }

    #[test]
    fn the_derivative_of_w_agrees_with_differences(
        eta2 in attitude(), p in -5.0..5.0, q in -5.0..5.0, r in -5.0..5.0,
    ) {
        let d_eta2 = Vector3::new(p, q, r);
        let dt = 1e-5;
        let after = w(&(eta2 + dt * d_eta2));
        let before = w(&(eta2 - dt * d_eta2));
        let dw = (after - before) / (2.0 * dt);
        prop_assert!((dw - matrix(|xi| RollPitch::of(&eta2).body_rate_dot(&d_eta2, xi))).amax() < 1e-7);
    }

    #[test]
    fn a_wrapped_angle_is_in_range_and_congruent(angle in -1e4..1e4) {
        let wrapped = wrap(angle);
        prop_assert!((-PI..PI).contains(&wrapped));
        let turns = (angle - wrapped) / TAU;
        prop_assert!((turns - turns.round()).abs() < 1e-9);
        prop_assert_eq!(wrap(wrapped), wrapped);
    }
}

#[test]
fn the_ends_of_the_range_wrap_to_its_lower_end() {
    for angle in [-PI, PI, 3.0 * PI, -3.0 * PI, PI.next_up()] {
        let wrapped = wrap(angle);
        assert!((-PI..PI).contains(&wrapped), "{angle} -> {wrapped}");
        assert!((wrapped + PI).abs() < 1e-15, "{angle} -> {wrapped}");
    }
}
