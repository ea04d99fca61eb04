//! Ranges of an airframe's parameters: they follow from what it was built with.
//!
//! The table [`crate::parameters::SPECS`] gives the ranges of the paper's airframe, which weighs half a kilogram. What
//! measures size (mass, lengths, inertias, coefficients of the rotors, drags) may go as far from the value that an
//! airframe was built with, as a factor, as the table allows from the paper's. What has no size (gravity, ratios, what
//! is 0 by default) has the range of the table for every airframe.

use crate::parameters::{Airframe, PARAMETERS, Parameter, ParameterError, Range, SPECS};

/// How much smaller than the least of the table, and larger than the greatest, a value may be that an airframe is built
/// with: half a ton, or an inertia of a tenth of a gram by square millimetre.
const SMALLER: f64 = 1e-6;
const LARGER: f64 = 100.0;

impl Parameter {
    /// Whether it measures the airframe's size, so that its range follows the airframe.
    #[must_use]
    pub const fn has_size(self) -> bool {
        matches!(
            self,
            Self::Mass
                | Self::TranslationalDrag
                | Self::RotationalDrag
                | Self::ArmLength
                | Self::ThrustCoefficient
                | Self::DragFactor
                | Self::RotorInertia
                | Self::InertiaX
                | Self::InertiaY
                | Self::InertiaZ
        )
    }

    /// Its range for an airframe that was built with the value `built`.
    ///
    /// Where that is 0 there is no factor, and the range is that of the table.
    #[must_use]
    pub fn range_of(self, built: f64) -> Range {
        let spec = self.spec();
        let size = (built / spec.nominal).abs();
        if !self.has_size() || built == 0.0 {
            return Range {
                min: spec.min,
                max: spec.max,
            };
        }
        let widest = self.widest();
        Range {
            min: (spec.min * size).max(widest.min),
            max: (spec.max * size).min(widest.max),
        }
    }

    /// What no airframe of any size is outside of.
    #[must_use]
    pub fn widest(self) -> Range {
        let spec = self.spec();
        if !self.has_size() {
            return Range {
                min: spec.min,
                max: spec.max,
            };
        }
        let min = if spec.min < 0.0 {
            spec.min * LARGER
        } else {
            spec.min * SMALLER
        };
        Range {
            min,
            max: spec.max * LARGER,
        }
    }
}

impl Airframe {
    /// An airframe that is built with these values, in the order of [`SPECS`].
    pub fn built_with(values: [f64; PARAMETERS]) -> Result<Self, ParameterError> {
        for (spec, value) in SPECS.iter().zip(values) {
            spec.parameter.widest().check(spec.parameter, value)?;
        }
        Ok(Self {
            values,
            built: values,
        })
    }

    /// The same airframe as it was built.
    #[must_use]
    pub const fn as_built(&self) -> Self {
        Self {
            values: self.built,
            built: self.built,
        }
    }

    /// The range of a parameter of this airframe.
    #[must_use]
    pub fn range(&self, parameter: Parameter) -> Range {
        parameter.range_of(self.built[parameter as usize])
    }

    /// Checks a value against the range of this airframe.
    pub fn check(&self, parameter: Parameter, value: f64) -> Result<f64, ParameterError> {
        self.range(parameter).check(parameter, value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_airframe_has_the_ranges_of_the_table_bit_for_bit() {
        let paper = Airframe::nominal();
        for spec in &SPECS {
            assert_eq!(
                paper.range(spec.parameter),
                Range {
                    min: spec.min,
                    max: spec.max
                },
                "{}",
                spec.name
            );
        }
    }

    #[test]
    fn a_small_airframe_has_small_ranges_and_ratios_keep_theirs() {
        let mut values = *Airframe::nominal().values();
        values[Parameter::Mass as usize] = 0.027;
        let mut small = Airframe::built_with(values).unwrap();
        let Range { min, max } = small.range(Parameter::Mass);
        assert!(
            (min - 0.05 * 0.027 / 0.52).abs() < 1e-15 && (max - 5.0 * 0.027 / 0.52).abs() < 1e-15
        );
        let error = small.set(Parameter::Mass, 0.52).unwrap_err().to_string();
        assert!(
            error.starts_with("mass_kg = 0.52 is out of range: allowed are 0.00259"),
            "{error}"
        );
        assert_eq!(small.set(Parameter::Mass, 0.03), Ok(()));
        assert_eq!((small.m(), small.as_built().m()), (0.03, 0.027));
        assert_eq!(
            small.range(Parameter::RotorEfficiency1),
            Range { min: 0.0, max: 1.0 }
        );
    }

    #[test]
    fn the_sign_of_the_rotors_spin_does_not_turn_the_range_over() {
        let range = Parameter::RotorInertia.range_of(-3.36e-5);
        assert_eq!(
            range,
            Range {
                min: -1e-3,
                max: 1e-3
            }
        );
        assert_eq!(
            Parameter::RotationalDrag.range_of(0.0),
            Range { min: 0.0, max: 1.0 }
        );
    }

    #[test]
    fn no_airframe_is_built_of_what_is_no_number_or_of_any_size() {
        for value in [f64::NAN, f64::INFINITY, -0.1, 0.0, 501.0] {
            let mut values = *Airframe::nominal().values();
            values[Parameter::Mass as usize] = value;
            assert!(Airframe::built_with(values).is_err(), "{value}");
        }
    }
}
