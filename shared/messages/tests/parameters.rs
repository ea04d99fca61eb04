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
    fn every_valid_array_is_an_airframe_and_comes_back_as_it_was(values in any_airframe()) {
        let airframe = Airframe::try_from(values).expect("each is within its range");
        prop_assert_eq!(<[f64; PARAMETERS]>::from(airframe), values);
        prop_assert_eq!(airframe.values(), &values);
        for spec in &SPECS {
            prop_assert_eq!(airframe.get(spec.parameter), values[spec.parameter as usize]);
        }
    }

    #[test]
    fn setting_changes_one_parameter_or_nothing(
        values in any_airframe(),
        (parameter, value) in any_parameter().prop_flat_map(|p| (Just(p), prop_oneof![within(p).boxed(), any_number().boxed()])),
    ) {
        let before = Airframe::try_from(values).expect("each is within its range");
        let mut after = before;
        let set = after.set(parameter, value);
        let spec = parameter.spec();
        if let Err(ParameterError::OutOfRange { parameter: named, value: refused, range }) = &set {
            prop_assert_eq!((range.min, range.max), (spec.min, spec.max));
            prop_assert!(!(spec.min..=spec.max).contains(&value));
            prop_assert_eq!((*named, refused.to_bits()), (parameter, value.to_bits()));
        }
        let mut array = values;
        array[parameter as usize] = value;
        prop_assert_eq!(Airframe::try_from(array).is_ok(), set.is_ok());
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
fn names_of_parameters_are_unique_and_end_in_their_unit() {
    for (i, spec) in SPECS.iter().enumerate() {
        assert!(
            SPECS[..i].iter().all(|earlier| earlier.name != spec.name),
            "{}",
            spec.name
        );
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
fn an_airframe_of_a_file_is_checked_like_any_other() {
    let nominal = serde_json::to_value(Airframe::nominal()).expect("an array of numbers");
    assert_eq!(
        serde_json::from_value::<Airframe>(nominal.clone()).expect("its own text"),
        Airframe::nominal()
    );
    let mut heavy = nominal.clone();
    heavy[Parameter::Mass as usize] = json!(5.5);
    let error = serde_json::from_value::<Airframe>(heavy).expect_err("too heavy");
    assert!(
        error
            .to_string()
            .contains("mass_kg = 5.5 is out of range: allowed are 0.05 to 5.0 kg"),
        "{error}"
    );
    let mut short = nominal;
    short.as_array_mut().expect("an array").pop();
    assert!(serde_json::from_value::<Airframe>(short).is_err());
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
