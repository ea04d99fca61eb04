//! Reference vectors: 50-digit evaluations of the equations, in named groups of cases (`vectors.json`).
//!
//! The tests of several crates include this file.
#![allow(dead_code, reason = "no crate uses all of it")]

use nalgebra::{Matrix3, SVector};
use serde_json::Value;

pub const TOLERANCE: f64 = 1e-12;

/// Runs a check on each case of a group.
pub fn each_case(group: &str, check: impl Fn(&Value)) {
    cases(include_str!("vectors.json"), group, 50)
        .iter()
        .for_each(check);
}

/// The cases of a group of vectors, which are so many.
pub fn cases(vectors: &str, group: &str, count: usize) -> Vec<Value> {
    let mut vectors: Value = serde_json::from_str(vectors).unwrap();
    let cases: Vec<Value> = serde_json::from_value(vectors[group].take()).unwrap();
    assert_eq!(cases.len(), count, "{group}");
    cases
}

pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

pub fn vector<const N: usize>(value: &Value) -> SVector<f64, N> {
    SVector::from_fn(|i, _| number(&value[i]))
}

pub fn matrix(value: &Value) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| number(&value[i][j]))
}

/// Numbers are close to those of a case: one number, a list, or the rows of a matrix.
pub fn assert_close(actual: &[f64], expected: &Value) {
    assert_within(actual, expected, TOLERANCE);
}

pub fn assert_within(actual: &[f64], expected: &Value, tolerance: f64) {
    let mut numbers = Vec::new();
    flatten(expected, &mut numbers);
    assert_eq!(actual.len(), numbers.len());
    for (a, b) in actual.iter().zip(numbers) {
        let error = (a - b).abs() / b.abs().max(1.0);
        assert!(error <= tolerance, "{a} for {b}: off by {error:e}");
    }
}

fn flatten(value: &Value, numbers: &mut Vec<f64>) {
    match value.as_array() {
        Some(list) => list.iter().for_each(|value| flatten(value, numbers)),
        None => numbers.push(number(value)),
    }
}
