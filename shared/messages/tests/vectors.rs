//! Frames, allocation and rate dynamics: 50 reference vectors each, to 1e-12.

use messages::allocation::{Allocation, net_speed};
use messages::frames::RollPitch;
use messages::parameters::Airframe;
use messages::rate_dynamics::{Inertia, disturbance};
use nalgebra::{Matrix3, Vector3, Vector4};
use serde_json::Value;

const TOLERANCE: f64 = 1e-12;

/// Runs a check on each case of a group, and insists on 50 of them.
fn each_case(group: &str, check: impl Fn(&Value)) {
    let vectors: Value = serde_json::from_str(include_str!("../../reference/vectors.json"))
        .expect("the vectors are JSON");
    let cases = vectors[group].as_array().expect("a group is a list");
    cases.iter().for_each(check);
    assert_eq!(cases.len(), 50, "{group}");
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn vector(value: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| number(&value[i]))
}

fn vector4(value: &Value) -> Vector4<f64> {
    Vector4::from_fn(|i, _| number(&value[i]))
}

fn assert_close(actual: &[f64], expected: &[f64]) {
    assert_eq!(actual.len(), expected.len());
    for (a, b) in actual.iter().zip(expected) {
        let error = (a - b).abs() / b.abs().max(1.0);
        assert!(error <= TOLERANCE, "{a} for {b}: off by {error:e}");
    }
}

/// The matrix of a linear map.
fn matrix(of: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::z()].map(|unit| of(&unit)))
}

fn check_frame(group: &str, frame: impl Fn(&Vector3<f64>) -> Matrix3<f64>) {
    each_case(group, |case| {
        let expected = Matrix3::from_fn(|i, j| number(&case["out"][i][j]));
        let actual = frame(&vector(&case["eul"]));
        assert_close(actual.as_slice(), expected.as_slice());
    });
}

#[test]
fn j1() {
    check_frame("J1", |eta2| RollPitch::of(eta2).rot_wb(eta2.z));
}

#[test]
fn j2() {
    check_frame("J2", |eta2| {
        matrix(|nu2| RollPitch::of(eta2).euler_rate(nu2))
    });
}

#[test]
fn w() {
    check_frame("W", |eta2| matrix(|xi| RollPitch::of(eta2).body_rate(xi)));
}

#[test]
fn regressors() {
    each_case("regressors", |case| {
        let inertia = Inertia::new(Airframe::nominal().i_m().into());
        let (nu2, om, t_s) = (vector(&case["nu"]), number(&case["Om"]), number(&case["t"]));
        let phi = inertia.regressor(&nu2, om, &disturbance(t_s));
        assert_close(
            inertia.coupling(&nu2).as_slice(),
            vector(&case["f"]).as_slice(),
        );
        assert_close(disturbance(t_s).as_slice(), vector(&case["h"]).as_slice());
        for (column, name) in ["g1", "g2", "h"].into_iter().enumerate() {
            let actual: Vector3<f64> = phi.column(column).into();
            assert_close(actual.as_slice(), vector(&case[name]).as_slice());
        }
    });
}

#[test]
fn alloc() {
    let allocation = Allocation::new(&Airframe::nominal());
    each_case("alloc", |case| {
        let (u, tau) = allocation.wrench(&vector4(&case["f"]));
        let expected = vector4(&case["out_u_tp_tq_tr"]);
        assert_close(&[u, tau.x, tau.y, tau.z], expected.as_slice());
    });
}

#[test]
fn alloc_inv() {
    let airframe = Airframe::nominal();
    let allocation = Allocation::new(&airframe);
    each_case("alloc_inv", |case| {
        let demand = vector4(&case["u_tp_tq_tr"]);
        let tau = Vector3::new(demand.y, demand.z, demand.w);
        let f = allocation.thrusts(demand.x, &tau);
        assert_close(f.as_slice(), vector4(&case["f"]).as_slice());
        let speed = f.map(|f| {
            if f < 0.0 {
                -1.0
            } else {
                (f / airframe.k()).sqrt()
            }
        });
        assert_close(speed.as_slice(), vector4(&case["Omega"]).as_slice());
    });
}

#[test]
fn omega_net() {
    each_case("omega_net", |case| {
        let om = net_speed(&vector4(&case["Omega"]));
        assert_close(&[om], &[number(&case["out"])]);
    });
}
