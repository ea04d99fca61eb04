//! The airframe's parameters under their names in MAVLink, and their values in single precision.

use mavlink::dialects::common::{MavParamType, PARAM_VALUE_DATA};
use messages::parameters::{PARAMETERS, Parameter, SPECS};

/// Ground stations look here whether failures may be injected: 1 with `--allow-control`.
pub const FAILURES_ENABLED: &str = "SYS_FAILURE_EN";

pub fn parameter_of(name: &str) -> Option<Parameter> {
    SPECS.get(index_of(name)?).map(|spec| spec.parameter)
}

/// Place of a parameter among those that are sent; [`FAILURES_ENABLED`] is the last one.
pub fn index_of(name: &str) -> Option<usize> {
    let mut names = SPECS.iter().map(|it| it.mavlink).chain([FAILURES_ENABLED]);
    names.position(|it| it == name)
}

/// A value of the parameter at a place.
pub fn value_of(index: usize, param_value: f32) -> PARAM_VALUE_DATA {
    let (name, param_type) = match SPECS.get(index) {
        Some(spec) => (spec.mavlink, MavParamType::MAV_PARAM_TYPE_REAL32),
        None => (FAILURES_ENABLED, MavParamType::MAV_PARAM_TYPE_INT32),
    };
    PARAM_VALUE_DATA {
        param_value,
        param_count: PARAMETERS as u16 + 1,
        param_index: index as u16,
        param_id: name.into(),
        param_type,
    }
}

/// The number that a single-precision value stands for: its shortest decimal form, which is what a user typed.
///
/// 0.315 arrives as 0.31499999761581421, and means 0.315, as `ironbird inject` would read it.
pub fn meant(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    #[test]
    fn names_fit_and_are_unique_and_reversible() {
        for spec in &SPECS {
            assert!(spec.mavlink.len() <= 16, "{}", spec.mavlink);
            assert_eq!(parameter_of(spec.mavlink), Some(spec.parameter));
        }
        assert_eq!(parameter_of(FAILURES_ENABLED), None);
        assert_eq!(parameter_of("MASS "), None);
    }

    #[test]
    fn every_nominal_value_comes_back_as_it_is() {
        for spec in &SPECS {
            assert_eq!(meant(spec.nominal as f32), spec.nominal, "{}", spec.name);
        }
        assert_eq!(meant(0.315), 0.315);
        assert_ne!(f64::from(0.315_f32), 0.315);
        assert!(meant(f32::NAN).is_nan());
        assert_eq!(meant(f32::INFINITY), f64::INFINITY);
    }

    proptest! {
        /// A value that is acknowledged has the bits that were sent; one that is read is within half a unit of the last place.
        #[test]
        fn values_survive_the_way_to_the_plant_and_back(bits in any::<u32>(), value in -1e6..1e6_f64) {
            let sent = f32::from_bits(bits);
            prop_assume!(!sent.is_nan());
            prop_assert_eq!((meant(sent) as f32).to_bits(), bits);
            let error = (meant(value as f32) - value).abs();
            prop_assert!(error <= value.abs() * f64::from(f32::EPSILON), "{value} {error}");
        }
    }
}
