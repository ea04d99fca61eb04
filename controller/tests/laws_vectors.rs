//! The laws besides the paper's against vectors of an independent implementation: flights of some ticks each.
//!
//! `vectors/laws.py` and `vectors/observers.py` make them from the formulas of the sources; they are run by hand.

use control_api::description::{SettingKind, Settings, Value};
use control_api::law::{Desired, InnerInput, InnerLaw, Law, OuterInput, OuterLaw, Rig};
use controller::laws::{AdaptiveResidual, Estimating, Geometric, Indi, L1, Mrac, Pid, Sliding};
use messages::layout::{Field, Visit, VisitorMut};
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter};
use messages::telemetry::Telemetry;
use serde_json::Value as Json;

use crate::reference::{TOLERANCE, cases};

fn number(json: &Json) -> f64 {
    json.as_f64().unwrap_or_default()
}

/// As many numbers as are asked for; 0 for what the law may not look at.
fn numbers<const N: usize>(json: &Json) -> [f64; N] {
    std::array::from_fn(|i| number(&json[i]))
}

fn tick_of(json: &Json) -> u64 {
    json.as_u64().expect("a tick")
}

fn rig(case: &Json) -> Rig {
    let mut airframe = Airframe::nominal();
    for (name, value) in case["airframe"].as_object().expect("an airframe") {
        if !name.starts_with("rotor_m") {
            airframe
                .set(Parameter::from_name(name).expect("known"), number(value))
                .expect("in range");
        }
    }
    let [min_rad_s, max_rad_s] =
        ["min", "max"].map(|end| number(&case["airframe"][format!("rotor_{end}_rad_s")]));
    Rig {
        period_s: number(&case["period_s"]),
        airframe,
        rotor: RotorLimits {
            min_rad_s,
            max_rad_s,
        },
    }
}

fn law_of<L: Law>(case: &Json) -> L {
    let given = &case["settings"];
    let values = L::DESCRIPTION.settings.iter().map(|setting| {
        let value = &given[setting.name];
        assert!(!value.is_null(), "{}", setting.name);
        let value = match setting.kind {
            SettingKind::Three { .. } => Value::Three(numbers(value)),
            SettingKind::Word(words) => {
                let word = words.iter().find(|word| value == **word);
                Value::Word(word.expect("a word of the setting"))
            }
            SettingKind::Number { .. } => Value::Number(number(value)),
        };
        (setting.name, value)
    });
    L::new(&rig(case), &Settings::new(values.collect())).expect("the settings go together")
}

/// Fills in the fields of a struct from the JSON object with their names.
struct Fields<'a>(&'a Json);

impl VisitorMut for Fields<'_> {
    fn integers(&mut self, field: &'static Field, values: &mut [u64]) {
        values[0] = u64::from(self.0[field.name].as_bool().unwrap_or_default());
    }

    fn numbers(&mut self, field: &'static Field, values: &mut [f64]) {
        let json = &self.0[field.name];
        match values {
            [value] => *value = number(json),
            values => (0..)
                .zip(values)
                .for_each(|(i, value)| *value = number(&json[i])),
        }
    }

    fn structs<L: Visit>(&mut self, _: &'static Field, _: &mut [L]) {}
}

/// Of what the law may not look at, the numbers are 0.
fn read<T: Visit + Default>(json: &Json) -> T {
    let mut content = T::default();
    content.visit_mut(&mut Fields(json));
    content
}

fn assert_close(what: &str, actual: &[f64], expected: &[f64]) {
    for (a, b) in actual.iter().zip(expected) {
        let error = (a - b).abs() / b.abs().max(1.0);
        assert!(error <= TOLERANCE, "{what}: {a} for {b}: off by {error:e}");
    }
}

/// Flies each case of a law through its ticks.
fn each_case<L: Law>(
    ask: impl Fn(&mut L, &Json, &mut Telemetry) -> Vec<f64>,
    expected: impl Fn(&Json) -> Vec<f64>,
) {
    let name = L::DESCRIPTION.name;
    let cases = match name {
        "estimating" | "geometric" | "indi" | "pid" => {
            cases(include_str!("vectors/laws.json"), name, 50)
        }
        _ => cases(include_str!("vectors/observers.json"), name, 8),
    };
    let signals = L::DESCRIPTION.telemetry.len();
    for (number_of_case, case) in cases.iter().enumerate() {
        let mut law: L = law_of(case);
        let mut telemetry = Telemetry::default();
        for row in case["ticks"].as_array().expect("a list of ticks") {
            let what = format!("{name}, case {number_of_case}, tick {}", row["tick"]);
            let answer = ask(&mut law, row, &mut telemetry);
            assert_close(&what, &answer, &expected(&row["out"]));
            let shown: [f64; 32] = numbers(&row["out"]["telemetry"]);
            let count = row["out"]["telemetry"].as_array().map(Vec::len);
            assert_eq!(count, Some(signals), "{what}");
            assert_close(&format!("{what}, telemetry"), &telemetry.value, &shown);
        }
    }
}

fn inner<L: Law + InnerLaw>() {
    each_case::<L>(
        |law, row, telemetry| {
            let (tick, measured_tick) = (tick_of(&row["tick"]), tick_of(&row["measured_tick"]));
            let input = InnerInput {
                tick,
                measured_age: tick - measured_tick,
                measured: read(&row["measured"]),
                wanted: read(&row["wanted"]),
                reference: read(&row["reference"]),
                ..InnerInput::default()
            };
            let demand = law.tick(&input, telemetry);
            [&[demand.thrust_n], &demand.torque_b_nm[..]].concat()
        },
        |out| {
            let torque = numbers::<3>(&out["torque_b_nm"]);
            [&[number(&out["thrust_n"])], &torque[..]].concat()
        },
    );
}

fn in_a_row(wanted: &Desired) -> Vec<f64> {
    let angles = [
        wanted.attitude_rad,
        wanted.attitude_rate_rad_s,
        wanted.attitude_acceleration_rad_s2,
    ]
    .concat();
    [&[wanted.thrust_n, wanted.limited as f64], &angles[..]].concat()
}

#[test]
fn estimating() {
    each_case::<Estimating>(
        |law, row, telemetry| {
            let input = OuterInput {
                tick: tick_of(&row["tick"]),
                measured: read(&row["measured"]),
                reference: read(&row["reference"]),
                ..OuterInput::default()
            };
            in_a_row(&law.tick(&input, telemetry))
        },
        |out| in_a_row(&read(out)),
    );
}

#[test]
fn inner_laws() {
    inner::<Geometric>();
    inner::<Indi>();
    inner::<Pid>();
    inner::<AdaptiveResidual>();
    inner::<L1>();
    inner::<Mrac>();
    inner::<Sliding>();
}
