//! The accelerations against the reference vectors, which are 50-digit evaluations.

use messages::attitude::Attitude;
use messages::parameters::Airframe;
use messages::rate_dynamics::disturbance;
use nalgebra::Vector3;
use plant::rigid_body::{Dynamics, Effort};
use serde_json::Value;

const CASES: usize = 50;
const TOLERANCE: f64 = 1e-12;

fn cases(group: &str) -> Vec<Value> {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../shared/reference/vectors.json"
    );
    let vectors: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let cases = vectors[group].as_array().unwrap().clone();
    assert_eq!(cases.len(), CASES, "cases of {group}");
    cases
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_iterator(value.as_array().unwrap().iter().map(number))
}

fn assert_close(actual: &Vector3<f64>, expected: &Vector3<f64>, case: usize) {
    for (a, e) in actual.iter().zip(expected) {
        assert!(
            (a - e).abs() / e.abs().max(1.0) <= TOLERANCE,
            "case {case}: {actual} is not {expected}"
        );
    }
}

#[test]
fn acceleration_by_equation_1() {
    let dynamics = Dynamics::new(&Airframe::nominal());
    for (i, case) in cases("acc_lin").iter().enumerate() {
        let eta2 = vector(&case["eul"]);
        let effort = Effort {
            u: number(&case["u"]),
            ..Effort::default()
        };
        let forcing = dynamics.forcing(&effort);
        let a = dynamics.linear_acceleration(
            &Attitude::of_euler(&eta2),
            &vector(&case["vel"]),
            &forcing,
        );
        assert_close(&a, &vector(&case["out"]), i);
    }
}

#[test]
fn angular_acceleration_by_equation_8() {
    let dynamics = Dynamics::new(&Airframe::nominal());
    for (i, case) in cases("acc_rot").iter().enumerate() {
        let effort = Effort {
            tau: vector(&case["tau"]),
            om: number(&case["Om"]),
            ..Effort::default()
        };
        let forcing =
            dynamics.disturbed(&dynamics.forcing(&effort), &disturbance(number(&case["t"])));
        let a = dynamics.angular_acceleration(&vector(&case["nu"]), &forcing);
        assert_close(&a, &vector(&case["out"]), i);
    }
}
