//! Parameters and rotor limits: every accepted value is in range, no other passes.

use messages::limits::RotorLimits;
use messages::parameters::{Airframe, PARAMETERS, Parameter, ParameterError, SPECS};
use proptest::prelude::*;
use serde_json::json;

/// Any number that 64 bits can hold, the special ones more often than their share.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<u64>().prop_map(f64::from_bits),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(-0.0),
        Just(f64::MIN_POSITIVE),
    ]
}

fn any_parameter() -> impl Strategy<Value = Parameter> {
    (0..PARAMETERS).prop_map(|i| SPECS[i].parameter)
}

/// A value within the range of a parameter, its bounds among them.
fn within(parameter: Parameter) -> impl Strategy<Value = f64> {
    let spec = parameter.spec();
    prop_oneof![Just(spec.min), Just(spec.max), spec.min..=spec.max]
}

/// A valid set: every parameter somewhere in its range.
fn any_airframe() -> impl Strategy<Value = [f64; PARAMETERS]> {
    let shares = prop::collection::vec(0.0..=1.0_f64, PARAMETERS);
    shares.prop_map(|shares| {
        std::array::from_fn(|i| {
            (SPECS[i].min + shares[i] * (SPECS[i].max - SPECS[i].min))
                .clamp(SPECS[i].min, SPECS[i].max)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn setting_changes_one_parameter_or_nothing(
        values in any_airframe(),
        (parameter, value) in any_parameter().prop_flat_map(|p| (Just(p), prop_oneof![within(p).boxed(), any_number().boxed()])),
    ) {
        let mut before = Airframe::nominal();
        for (spec, value) in SPECS.iter().zip(values) {
            prop_assert_eq!(before.set(spec.parameter, value), Ok(()));
        }
        let mut after = before;
        let set = after.set(parameter, value);
        let spec = parameter.spec();
        if let Err(ParameterError::OutOfRange { parameter: named, value: refused, range }) = &set {
            prop_assert_eq!((range.min, range.max), (spec.min, spec.max));
            prop_assert!(!(spec.min..=spec.max).contains(&value));
            prop_assert_eq!((*named, refused.to_bits()), (parameter, value.to_bits()));
        }
        prop_assert_eq!(set.is_ok(), parameter.check(value).is_ok());
        prop_assert_eq!(after.get(parameter), if set.is_ok() { value } else { before.get(parameter) });
        for other in SPECS.iter().map(|spec| spec.parameter).filter(|other| *other != parameter) {
            prop_assert_eq!(after.get(other), before.get(other));
        }
    }

    #[test]
    fn an_index_of_the_wire_is_a_parameter_of_the_table_or_none(index in prop_oneof![0..40_u64, any::<u64>()]) {
        let found = Parameter::from_index(index);
        prop_assert_eq!(found.map(|parameter| parameter as u64), (index < PARAMETERS as u64).then_some(index));
    }

    #[test]
    fn any_text_is_a_parameter_or_gets_a_hint_at_one_that_there_is(text in "[a-z0-9_ ]{0,30}") {
        match Parameter::from_name(&text) {
            Ok(parameter) => prop_assert_eq!(parameter.name(), text),
            Err(ParameterError::Unknown { name, nearest }) => {
                prop_assert_eq!(name, text);
                prop_assert!(nearest.is_none_or(|nearest| Parameter::from_name(nearest).is_ok()));
            }
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}

#[test]
fn names_of_parameters_end_in_their_unit() {
    for spec in &SPECS {
        let letters = spec.unit.replace("N m", "nm").replace('N', "n");
        let letters = letters
            .replace("Hz", "hz")
            .replace('^', "")
            .replace([' ', '/'], "_");
        let unit = if letters.is_empty() {
            String::new()
        } else {
            format!("_{letters}")
        };
        assert!(spec.name.ends_with(&unit), "{} [{}]", spec.name, spec.unit);
    }
}

#[test]
fn the_nominal_airframe_hovers_within_the_default_limits() {
    let (airframe, limits) = (Airframe::nominal(), RotorLimits::default());
    let hover = airframe.hover_speed_rad_s();
    assert!(
        (limits.min_rad_s..limits.max_rad_s).contains(&hover),
        "{hover}"
    );
    let weight = airframe.m() * airframe.g();
    assert!(4.0 * limits.f_min(airframe.k()) < weight && weight < 4.0 * limits.f_max(airframe.k()));
    assert!((4.0 * airframe.k() * hover * hover - weight).abs() < 1e-12);
}

#[test]
fn limits_of_a_file_have_both_keys_and_no_other() {
    let parse = |value| serde_json::from_value::<RotorLimits>(value);
    let limits = parse(json!({ "min_rad_s": 30.0, "max_rad_s": 350.0 })).expect("both keys");
    assert_eq!(limits, RotorLimits::default());
    assert!(parse(json!({ "min_rad_s": 30.0 })).is_err());
    assert!(parse(json!({ "min_rad_s": 30.0, "max_rad_s": 350.0, "max_rpm": 3000.0 })).is_err());
}
