//! The airframe: a value for every parameter, by the paper's symbols.

use serde::{Deserialize, Serialize};

use crate::content::ROTORS;
use crate::parameters::{PARAMETERS, Parameter, ParameterError, SPECS};

/// A full set of parameters, each within its range, and the values that the airframe was built with.
///
/// The ranges follow from what it was built with ([`crate::ranges`]). Indexed by [`Parameter`]; the accessors are the
/// paper's symbols. As an array of numbers it is the paper's airframe with these values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "[f64; PARAMETERS]", try_from = "[f64; PARAMETERS]")]
pub struct Airframe {
    pub(crate) values: [f64; PARAMETERS],
    pub(crate) built: [f64; PARAMETERS],
}

impl Airframe {
    /// The paper's Table I, with every effect beyond the paper switched off.
    #[must_use]
    pub const fn nominal() -> Self {
        let mut values = [0.0; PARAMETERS];
        let mut i = 0;
        while i < PARAMETERS {
            values[i] = SPECS[i].nominal;
            i += 1;
        }
        Self {
            values,
            built: values,
        }
    }

    /// The value of a parameter, in its unit.
    #[must_use]
    #[inline]
    pub const fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter as usize]
    }

    pub fn set(&mut self, parameter: Parameter, value: f64) -> Result<(), ParameterError> {
        self.values[parameter as usize] = self.check(parameter, value)?;
        Ok(())
    }

    /// All values in the order of [`SPECS`].
    #[must_use]
    #[inline]
    pub const fn values(&self) -> &[f64; PARAMETERS] {
        &self.values
    }

    /// m [kg].
    #[must_use]
    #[inline]
    pub const fn m(&self) -> f64 {
        self.get(Parameter::Mass)
    }

    /// g [m/s^2].
    #[must_use]
    #[inline]
    pub const fn g(&self) -> f64 {
        self.get(Parameter::Gravity)
    }

    /// k_t [kg/s].
    #[must_use]
    #[inline]
    pub const fn k_t(&self) -> f64 {
        self.get(Parameter::TranslationalDrag)
    }

    /// k_r [N m s].
    #[must_use]
    #[inline]
    pub const fn k_r(&self) -> f64 {
        self.get(Parameter::RotationalDrag)
    }

    /// l [m].
    #[must_use]
    #[inline]
    pub const fn l(&self) -> f64 {
        self.get(Parameter::ArmLength)
    }

    /// k [N s^2].
    #[must_use]
    #[inline]
    pub const fn k(&self) -> f64 {
        self.get(Parameter::ThrustCoefficient)
    }

    /// d [N m s^2].
    #[must_use]
    #[inline]
    pub const fn d(&self) -> f64 {
        self.get(Parameter::DragFactor)
    }

    /// I_R [kg m^2].
    #[must_use]
    #[inline]
    pub const fn i_r(&self) -> f64 {
        self.get(Parameter::RotorInertia)
    }

    /// Diagonal of I_M: I_x, I_y, I_z [kg m^2].
    #[must_use]
    #[inline]
    pub const fn i_m(&self) -> [f64; 3] {
        [
            self.get(Parameter::InertiaX),
            self.get(Parameter::InertiaY),
            self.get(Parameter::InertiaZ),
        ]
    }

    /// delta [rad/s^2].
    #[must_use]
    #[inline]
    pub const fn delta(&self) -> f64 {
        self.get(Parameter::DisturbanceGain)
    }

    /// Efficiency of each rotor, 0 to 1.
    #[must_use]
    #[inline]
    pub const fn rotor_efficiency(&self) -> [f64; ROTORS] {
        [
            self.get(Parameter::RotorEfficiency1),
            self.get(Parameter::RotorEfficiency2),
            self.get(Parameter::RotorEfficiency3),
            self.get(Parameter::RotorEfficiency4),
        ]
    }

    /// Time constant of the motors [s]; 0 is no lag.
    #[must_use]
    #[inline]
    pub const fn motor_time_constant_s(&self) -> f64 {
        self.get(Parameter::MotorTimeConstant)
    }

    /// Standard deviation of the gyro noise per sample [rad/s].
    #[must_use]
    #[inline]
    pub const fn gyro_noise_rad_s(&self) -> f64 {
        self.get(Parameter::GyroNoise)
    }

    /// Whether the measured rates differ from the true ones.
    #[must_use]
    pub fn gyro_errs(values: &[f64; PARAMETERS]) -> bool {
        use Parameter::{GyroBias, GyroDrift, GyroNoise, GyroNoiseDensity};
        [GyroNoise, GyroNoiseDensity, GyroBias, GyroDrift]
            .iter()
            .any(|&parameter| values[parameter as usize] != 0.0)
    }

    /// Speed of each rotor in hover, sqrt(m g / 4 k) [rad/s].
    #[must_use]
    #[inline]
    pub fn hover_speed_rad_s(&self) -> f64 {
        (self.m() * self.g() / (4.0 * self.k())).sqrt()
    }
}

impl From<Airframe> for [f64; PARAMETERS] {
    fn from(airframe: Airframe) -> Self {
        airframe.values
    }
}

impl TryFrom<[f64; PARAMETERS]> for Airframe {
    type Error = ParameterError;

    fn try_from(values: [f64; PARAMETERS]) -> Result<Self, ParameterError> {
        for (spec, value) in SPECS.iter().zip(values) {
            spec.parameter.check(value)?;
        }
        Ok(Self {
            values,
            ..Self::nominal()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused_and_change_nothing() {
        let mut airframe = Airframe::nominal();
        for value in [-1.0, f64::NAN, f64::INFINITY, 5.1] {
            let error = airframe.set(Parameter::Mass, value).unwrap_err();
            assert!(
                error
                    .to_string()
                    .starts_with(&format!("mass_kg = {value} is out of range")),
                "{error}"
            );
        }
        assert_eq!(airframe, Airframe::nominal());
    }
}
