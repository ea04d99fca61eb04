//! The airframe's parameters: names, units, ranges, nominal values, equations.
//!
//! One table describes every parameter that the plant knows. The plant flies the *true* values, which can be swapped in
//! flight. The controller and the mixer hold the *nominal* values of the same type as their model. Raw numbers become
//! an [`Airframe`] only through [`Airframe::set`], which checks the range.

use std::fmt;

use ironbird_law::abi::IRONBIRD_ROTORS as ROTORS;
use thiserror::Error;

/// The parameters that the inner loop estimates, in the order of theta: I_R, k_r, delta.
pub const ESTIMATED: [Parameter; 3] = [
    Parameter::RotorInertia,
    Parameter::RotationalDrag,
    Parameter::DisturbanceGain,
];

/// Efficiencies of the rotors, 1 to 4.
pub const ROTOR_EFFICIENCY: [Parameter; ROTORS] = [
    Parameter::RotorEfficiency1,
    Parameter::RotorEfficiency2,
    Parameter::RotorEfficiency3,
    Parameter::RotorEfficiency4,
];

/// What is known about a parameter before any flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spec {
    pub parameter: Parameter,
    /// Name with its unit, as typed by the user.
    pub name: &'static str,
    /// Name in MAVLink, of at most 16 characters.
    pub mavlink: &'static str,
    pub unit: &'static str,
    pub min: f64,
    pub max: f64,
    /// The paper's Table I, or the value that switches an effect beyond the paper off.
    pub nominal: f64,
    /// The paper's equations that it enters; `beyond` where the paper has none.
    pub equation: &'static str,
    /// What it is, in a few words.
    pub meaning: &'static str,
}

impl Spec {
    /// The range of the paper's airframe.
    const fn range(&self) -> Range {
        Range {
            min: self.min,
            max: self.max,
        }
    }
}

/// Makes the parameters and their table of its rows: parameter, name, name in MAVLink, unit, range, nominal value, equation, meaning.
macro_rules! parameters {
    ($($parameter:ident, $name:literal, $mavlink:literal, $unit:literal, $min:literal ..= $max:literal, $nominal:literal, $equation:literal, $meaning:literal;)+) => {
        /// Every parameter of the airframe, in the order of the wire, of `ironbird params` and of the report.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(usize)]
        #[allow(missing_docs, reason = "the table SPECS documents each one")]
        pub enum Parameter {
            $($parameter),+
        }

        pub const PARAMETERS: usize = [$($name),+].len();

        /// How many of them, the first ones, are always in the hash of a flight's outputs; the later ones only where they
        /// are not 0.
        pub const FIRST_PARAMETERS: usize = 28;

        /// The table: nominal values are the paper's Table I; the thrust coefficient, missing there, is that of
        /// Bouabdallah's OS4 (see docs/paper.md).
        pub const SPECS: [Spec; PARAMETERS] = [$(Spec {
            parameter: Parameter::$parameter,
            name: $name,
            mavlink: $mavlink,
            unit: $unit,
            min: $min,
            max: $max,
            nominal: $nominal,
            equation: $equation,
            meaning: $meaning,
        }),+];
    };
}

parameters! {
    Mass, "mass_kg", "MASS", "kg", 0.05..=5.0, 0.52, "(1)", "mass";
    Gravity, "gravity_m_s2", "GRAVITY", "m/s^2", 0.0..=30.0, 9.8, "(1)", "gravity along -z of the world";
    TranslationalDrag, "translational_drag_kg_s", "TRANS_DRAG", "kg/s", 0.0..=10.0, 0.95, "(1)", "linear drag of translation, k_t";
    RotationalDrag, "rotational_drag_nm_s", "ROT_DRAG", "N m s", 0.0..=1.0, 0.105, "(3)", "linear drag of rotation, k_r";
    ArmLength, "arm_length_m", "ARM_LENGTH", "m", 0.02..=2.0, 0.205, "(7)", "centre to rotor, l";
    ThrustCoefficient, "thrust_coefficient_n_s2", "THRUST_COEFF", "N s^2", 1e-6..=1e-3, 3.13e-5, "(6)", "thrust per squared rotor speed, k";
    DragFactor, "drag_factor_nm_s2", "DRAG_FACTOR", "N m s^2", 0.0..=1e-4, 7.5e-7, "(7)", "drag torque per squared rotor speed, d";
    RotorInertia, "rotor_inertia_kg_m2", "ROTOR_INERTIA", "kg m^2", -1e-3..=1e-3, 3.36e-5, "(3)", "rotor inertia, I_R; its sign is the spin sense, negative the physical one";
    InertiaX, "inertia_x_kg_m2", "INERTIA_X", "kg m^2", 1e-4..=1.0, 0.0069, "(3)", "moment of inertia about body x";
    InertiaY, "inertia_y_kg_m2", "INERTIA_Y", "kg m^2", 1e-4..=1.0, 0.0069, "(3)", "moment of inertia about body y";
    InertiaZ, "inertia_z_kg_m2", "INERTIA_Z", "kg m^2", 1e-4..=1.0, 0.0129, "(3)", "moment of inertia about body z";
    DisturbanceGain, "disturbance_gain_rad_s2", "DISTURB_GAIN", "rad/s^2", -2.0..=2.0, 0.2, "(3)", "gain of the disturbance h(t), delta";
    RotorEfficiency1, "rotor_efficiency_1", "ROTOR_EFF_1", "", 0.0..=1.0, 1.0, "beyond", "share of its thrust and drag torque that rotor 1 gives";
    RotorEfficiency2, "rotor_efficiency_2", "ROTOR_EFF_2", "", 0.0..=1.0, 1.0, "beyond", "share of its thrust and drag torque that rotor 2 gives";
    RotorEfficiency3, "rotor_efficiency_3", "ROTOR_EFF_3", "", 0.0..=1.0, 1.0, "beyond", "share of its thrust and drag torque that rotor 3 gives";
    RotorEfficiency4, "rotor_efficiency_4", "ROTOR_EFF_4", "", 0.0..=1.0, 1.0, "beyond", "share of its thrust and drag torque that rotor 4 gives";
    MotorTimeConstant, "motor_time_constant_s", "MOTOR_LAG", "s", 0.0..=1.0, 0.0, "beyond", "first-order lag of the rotor speeds; 0 is none";
    CommandDelay, "command_delay_s", "COMMAND_DELAY", "s", 0.0..=0.01, 0.0, "beyond", "delay from a command in force to the motors, in whole ticks";
    PositionNoise, "position_noise_m", "POS_NOISE", "m", 0.0..=10.0, 0.0, "beyond", "standard deviation of a position fix, per axis";
    VelocityNoise, "velocity_noise_m_s", "VEL_NOISE", "m/s", 0.0..=10.0, 0.0, "beyond", "standard deviation of a fix's velocity, per axis";
    PositionDelay, "position_delay_s", "POS_DELAY", "s", 0.0..=1.0, 0.0, "beyond", "age of a fix of position and velocity when it arrives";
    PositionRate, "position_rate_hz", "POS_RATE", "Hz", 0.0..=1000.0, 0.0, "beyond", "fixes of position and velocity a second; 0 is one a tick";
    AccelerometerNoise, "accel_noise_m_s2_rthz", "ACCEL_DENSITY", "m/s^2/rtHz", 0.0..=1.0, 0.0, "beyond", "white noise of the specific force, as a density";
    AccelerometerBias, "accel_bias_m_s2", "ACCEL_BIAS", "m/s^2", -5.0..=5.0, 0.0, "beyond", "bias of the specific force, on each axis";
    GyroBias, "gyro_bias_rad_s", "GYRO_BIAS", "rad/s", -1.0..=1.0, 0.0, "beyond", "bias of the measured rates, on each axis";
    GyroDrift, "gyro_drift_rad_s2_rthz", "GYRO_DRIFT", "rad/s^2/rtHz", 0.0..=0.1, 0.0, "beyond", "random walk of the gyro's bias, as a density";
    GyroNoiseDensity, "gyro_noise_rad_s_rthz", "GYRO_DENSITY", "rad/s/rtHz", 0.0..=0.1, 0.0, "beyond", "white noise of the measured rates, as a density";
    GyroNoise, "gyro_noise_rad_s", "GYRO_NOISE", "rad/s", 0.0..=1.0, 0.0, "beyond", "standard deviation of the measured rates, per sample, whatever T";
    WindX, "wind_x_m_s", "WIND_X", "m/s", -50.0..=50.0, 0.0, "beyond", "velocity of the air along world x";
    WindY, "wind_y_m_s", "WIND_Y", "m/s", -50.0..=50.0, 0.0, "beyond", "velocity of the air along world y";
    WindZ, "wind_z_m_s", "WIND_Z", "m/s", -50.0..=50.0, 0.0, "beyond", "velocity of the air along world z";
    Turbulence, "turbulence_w20_m_s", "TURBULENCE_W20", "m/s", 0.0..=50.0, 0.0, "beyond", "wind at 20 ft that sets the Dryden turbulence; 0 is none";
}

impl Parameter {
    #[inline]
    pub const fn spec(self) -> &'static Spec {
        &SPECS[self as usize]
    }

    /// Its name with unit, as typed by the user.
    #[inline]
    pub const fn name(self) -> &'static str {
        self.spec().name
    }

    /// The parameter of an index on the wire, if there is one.
    pub fn from_index(index: u64) -> Option<Self> {
        usize::try_from(index)
            .ok()
            .and_then(|i| SPECS.get(i))
            .map(|spec| spec.parameter)
    }

    pub fn from_name(name: &str) -> Result<Self, ParameterError> {
        SPECS
            .iter()
            .find(|spec| spec.name == name)
            .map(|spec| spec.parameter)
            .ok_or_else(|| {
                let nearest = nearest(name, SPECS.iter().map(|spec| spec.name));
                ParameterError::Unknown {
                    name: name.to_owned(),
                    nearest,
                }
            })
    }

    /// Checks a value against the range that the parameter has for the paper's airframe.
    pub fn check(self, value: f64) -> Result<f64, ParameterError> {
        self.spec().range().check(self, value)
    }

    /// Whether it measures the airframe's size, so that its range follows the airframe.
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
    pub fn range_of(self, built: f64) -> Range {
        let spec = self.spec();
        let size = (built / spec.nominal).abs();
        if !self.has_size() || built == 0.0 {
            return spec.range();
        }
        let widest = self.widest();
        Range {
            min: (spec.min * size).max(widest.min),
            max: (spec.max * size).min(widest.max),
        }
    }

    /// What no airframe of any size is outside of.
    pub fn widest(self) -> Range {
        let spec = self.spec();
        if !self.has_size() {
            return spec.range();
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

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Values that are allowed, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    pub min: f64,
    pub max: f64,
}

impl Range {
    /// Gives a value that is within the range.
    pub fn check(self, parameter: Parameter, value: f64) -> Result<f64, ParameterError> {
        if (self.min..=self.max).contains(&value) {
            Ok(value)
        } else {
            Err(ParameterError::OutOfRange {
                parameter,
                value,
                range: self,
            })
        }
    }
}

#[derive(Clone, Debug, PartialEq, Error)]
pub enum ParameterError {
    #[error("unknown parameter `{name}`{}", did_you_mean(*nearest))]
    Unknown {
        name: String,
        /// The known name most like it, where one is like it at all.
        nearest: Option<&'static str>,
    },
    /// The value is outside the range of the parameter.
    #[error(
        "{} = {} is out of range: allowed are {:?} to {:?}{}",
        parameter.name(), shown(*value), range.min, range.max, after_blank(parameter.spec().unit)
    )]
    OutOfRange {
        parameter: Parameter,
        value: f64,
        range: Range,
    },
}

/// A full set of parameters, each within its range, and the values that the airframe was built with.
///
/// The ranges follow from what it was built with ([`Parameter::range_of`]). Indexed by [`Parameter`]; the accessors are the
/// paper's symbols.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Airframe {
    values: [f64; PARAMETERS],
    built: [f64; PARAMETERS],
}

impl Airframe {
    /// The paper's Table I, with every effect beyond the paper switched off.
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

    #[inline]
    pub const fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter as usize]
    }

    pub fn set(&mut self, parameter: Parameter, value: f64) -> Result<(), ParameterError> {
        self.values[parameter as usize] = self.check(parameter, value)?;
        Ok(())
    }

    /// All values in the order of [`SPECS`].
    #[inline]
    pub const fn values(&self) -> &[f64; PARAMETERS] {
        &self.values
    }

    /// Diagonal of I_M: I_x, I_y, I_z [kg m^2].
    #[inline]
    pub const fn i_m(&self) -> [f64; 3] {
        use Parameter::{InertiaX, InertiaY, InertiaZ};
        [self.get(InertiaX), self.get(InertiaY), self.get(InertiaZ)]
    }

    /// Mean velocity of the air, world frame [m/s].
    #[inline]
    pub const fn wind(&self) -> [f64; 3] {
        use Parameter::{WindX, WindY, WindZ};
        [self.get(WindX), self.get(WindY), self.get(WindZ)]
    }

    /// Efficiency of each rotor, 0 to 1.
    #[inline]
    pub fn rotor_efficiency(&self) -> [f64; ROTORS] {
        ROTOR_EFFICIENCY.map(|parameter| self.get(parameter))
    }

    /// Whether the measured rates differ from the true ones.
    pub fn gyro_errs(values: &[f64; PARAMETERS]) -> bool {
        use Parameter::{GyroBias, GyroDrift, GyroNoise, GyroNoiseDensity};
        [GyroNoise, GyroNoiseDensity, GyroBias, GyroDrift]
            .iter()
            .any(|&parameter| values[parameter as usize] != 0.0)
    }

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
    pub const fn as_built(&self) -> Self {
        Self {
            values: self.built,
            built: self.built,
        }
    }

    pub fn range(&self, parameter: Parameter) -> Range {
        parameter.range_of(self.built[parameter as usize])
    }

    /// Checks a value against the range of this airframe.
    pub fn check(&self, parameter: Parameter, value: f64) -> Result<f64, ParameterError> {
        self.range(parameter).check(parameter, value)
    }

    /// Speed of each rotor in hover, sqrt(m g / 4 k) [rad/s].
    #[inline]
    pub fn hover_speed_rad_s(&self) -> f64 {
        (self.m() * self.g() / (4.0 * self.k())).sqrt()
    }
}

/// Accessors by the paper's symbols.
macro_rules! symbols {
    ($($(#[$doc:meta])* $symbol:ident => $parameter:ident;)+) => {
        impl Airframe {
            $($(#[$doc])*
            #[inline]
            pub const fn $symbol(&self) -> f64 {
                self.get(Parameter::$parameter)
            })+
        }
    };
}

symbols! {
    /// m [kg].
    m => Mass;
    /// g [m/s^2].
    g => Gravity;
    /// k_t [kg/s].
    k_t => TranslationalDrag;
    /// k_r [N m s].
    k_r => RotationalDrag;
    /// l [m].
    l => ArmLength;
    /// k [N s^2].
    k => ThrustCoefficient;
    /// d [N m s^2].
    d => DragFactor;
    /// I_R [kg m^2].
    i_r => RotorInertia;
    /// delta [rad/s^2].
    delta => DisturbanceGain;
    /// Time constant of the motors [s]; 0 is no lag.
    motor_time_constant_s => MotorTimeConstant;
    /// Standard deviation of the gyro noise per sample [rad/s].
    gyro_noise_rad_s => GyroNoise;
}

/// How much smaller than the least of the table, and larger than the greatest, a value may be that an airframe is built
/// with: half a ton, or an inertia of a tenth of a gram by square millimetre.
const SMALLER: f64 = 1e-6;
const LARGER: f64 = 100.0;

/// Likeness (Jaro-Winkler, 0 to 1) from which on a name may have been meant: below it, a suggestion would be a guess.
const LIKE: f64 = 0.8;

/// The name that may have been meant by one that is not known.
pub fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let likeness = |known: &str| strsim::jaro_winkler(known, name);
    known
        .max_by(|a, b| likeness(a).total_cmp(&likeness(b)))
        .filter(|nearest| likeness(nearest) >= LIKE)
}

/// The end of an error about a name that is not known.
pub fn did_you_mean(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |nearest| {
        format!("; did you mean `{nearest}`?")
    })
}

/// A number as it was typed; one of very many digits as a power of ten.
pub fn shown(value: f64) -> String {
    let whole = value.to_string();
    if whole.len() > 24 {
        format!("{value:e}")
    } else {
        whole
    }
}

/// A unit as it stands after a number; a ratio has none.
pub fn after_blank(unit: &str) -> String {
    if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_enum() {
        for (i, spec) in SPECS.iter().enumerate() {
            assert_eq!(spec.parameter as usize, i, "{}", spec.name);
            assert_eq!(Parameter::from_name(spec.name), Ok(spec.parameter));
            assert_eq!(spec.parameter.check(spec.nominal), Ok(spec.nominal));
        }
    }

    #[test]
    fn an_unknown_name_gets_the_nearest_one() {
        for (name, hint) in [
            ("mass", "; did you mean `mass_kg`?"),
            ("rotor_efficency_3", "; did you mean `rotor_efficiency_3`?"),
            ("nope", ""),
            ("x", ""),
            ("", ""),
            ("quaternion", ""),
        ] {
            let error = Parameter::from_name(name).unwrap_err().to_string();
            assert_eq!(error, format!("unknown parameter `{name}`{hint}"));
        }
    }

    #[test]
    fn a_number_of_hundreds_of_digits_is_printed_in_short() {
        for (value, text) in [(1e300, "1e300"), (-1e-300, "-1e-300"), (50.25, "50.25")] {
            let error = Parameter::Mass.check(value).unwrap_err().to_string();
            let expected = format!("mass_kg = {text} is out of range");
            assert!(error.starts_with(&expected), "{error}");
        }
    }

    #[test]
    fn ranges_follow_the_size_of_the_airframe() {
        let paper = Airframe::nominal();
        for spec in &SPECS {
            assert_eq!(paper.range(spec.parameter), spec.range(), "{}", spec.name);
        }
        let mut values = *paper.values();
        values[Parameter::Mass as usize] = 0.027;
        let mut small = Airframe::built_with(values).unwrap();
        let Range { min, max } = small.range(Parameter::Mass);
        assert!((min - 0.05 * 0.027 / 0.52).abs() < 1e-15);
        assert!((max - 5.0 * 0.027 / 0.52).abs() < 1e-15);
        let error = small.set(Parameter::Mass, 0.52).unwrap_err().to_string();
        let expected = "mass_kg = 0.52 is out of range: allowed are 0.00259";
        assert!(error.starts_with(expected), "{error}");
        assert_eq!(small.set(Parameter::Mass, 0.03), Ok(()));
        assert_eq!((small.m(), small.as_built().m()), (0.03, 0.027));
        let unit = Range { min: 0.0, max: 1.0 };
        assert_eq!(small.range(Parameter::RotorEfficiency1), unit);
        // The sign of the rotors' spin does not turn the range over, and 0 has no size.
        let (min, max) = (-1e-3, 1e-3);
        let inertia = Parameter::RotorInertia.range_of(-3.36e-5);
        assert_eq!(inertia, Range { min, max });
        assert_eq!(Parameter::RotationalDrag.range_of(0.0), unit);
        for value in [f64::NAN, f64::INFINITY, -0.1, 0.0, 501.0] {
            values[Parameter::Mass as usize] = value;
            assert!(Airframe::built_with(values).is_err(), "{value}");
        }
    }
}
