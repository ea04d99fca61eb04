//! Parameters as lists show them, and their values as text.

use messages::blackboards::ActiveParameters;
use messages::parameters::{Airframe, PARAMETERS, SPECS};
use serde::Serialize;

#[derive(Serialize)]
pub struct Row {
    pub name: &'static str,
    pub unit: &'static str,
    pub min: f64,
    pub max: f64,
    pub nominal: f64,
    /// None without a flight.
    pub in_force: Option<f64>,
    pub equation: &'static str,
    pub meaning: &'static str,
}

/// The parameters of an airframe, with the values that are active in a flight.
pub fn rows(airframe: &Airframe, active: Option<&ActiveParameters>) -> [Row; PARAMETERS] {
    SPECS.each_ref().map(|spec| Row {
        name: spec.name,
        unit: spec.unit,
        min: airframe.range(spec.parameter).min,
        max: airframe.range(spec.parameter).max,
        nominal: airframe.as_built().get(spec.parameter),
        in_force: active.map(|active| active.value[spec.parameter as usize]),
        equation: spec.equation,
        meaning: spec.meaning,
    })
}

/// An end of a range. That of an airframe of another size is a quotient with many digits, and is shortened.
pub fn bound(value: f64) -> String {
    let text = number(value);
    if text.len() > 8 {
        format!("{value:.2e}")
    } else {
        text
    }
}

/// A value as a user types it; small ones as powers of ten. One on a ramp has many digits, and is shortened.
pub fn number(value: f64) -> String {
    let is_small = value != 0.0 && value.abs() < 1e-3;
    let text = match is_small {
        true => format!("{value:e}"),
        false => format!("{value}"),
    };
    match (text.len() > 12, is_small) {
        (false, _) => text,
        (true, true) => format!("{value:.3e}"),
        (true, false) => format!("{value:.6}"),
    }
}
