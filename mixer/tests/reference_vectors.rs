//! Mixing and allocation against the reference vectors (50-digit evaluations).

use messages::allocation::Allocation;
use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use mixer::mix::{mix, speeds};
use nalgebra::{Vector3, Vector4};
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

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

fn assert_close(actual: &Vector4<f64>, expected: &[f64], case: usize) {
    assert_eq!(expected.len(), 4);
    for (a, e) in actual.iter().zip(expected) {
        assert!(
            (a - e).abs() / e.abs().max(1.0) <= TOLERANCE,
            "case {case}: {actual} is not {expected:?}"
        );
    }
}

#[test]
fn rotor_thrusts_of_a_demand() {
    let model = Airframe::nominal();
    let allocation = Allocation::new(&model);
    for (i, case) in cases("mixer").iter().enumerate() {
        let rotor = RotorLimits {
            min_rad_s: number(&case["omega_min"]),
            max_rad_s: number(&case["omega_max"]),
        };
        let (f_min, f_max) = (rotor.f_min(model.k()), rotor.f_max(model.k()));
        let tau = Vector3::from_column_slice(&numbers(&case["tau"]));
        let mix = mix(&allocation, number(&case["u"]), &tau, f_min, f_max);
        assert_close(&mix.f, &numbers(&case["f"]), i);
        assert_eq!(
            u64::from(mix.saturated),
            case["saturated"].as_u64().unwrap(),
            "case {i}"
        );
    }
}

#[test]
fn allocation_inverted_without_limits() {
    let model = Airframe::nominal();
    for (i, case) in cases("alloc_inv").iter().enumerate() {
        let demand = numbers(&case["u_tp_tq_tr"]);
        let f =
            Allocation::new(&model).thrusts(demand[0], &Vector3::from_column_slice(&demand[1..]));
        assert_close(&f, &numbers(&case["f"]), i);
        // The reference marks the speed of a negative thrust, which does not exist, by -1.
        let w = speeds(&f, model.k()).map(|w| if w.is_nan() { -1.0 } else { w });
        assert_close(&w, &numbers(&case["Omega"]), i);
    }
}
