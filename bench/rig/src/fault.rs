//! Faults as the user types them: `NAME=VALUE[,NAME=VALUE]@8s` or `@tick8000`.
//!
//! A value is a number, `nominal`, or a share of that which is added, as in `+30%`. Nominal is what the airframe was
//! built with, so what a value is, and whether it is in range, shows only with an airframe.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use model::parameters::{Airframe, Parameter, ParameterError};
use plant::{Swap, SwapError};
use thiserror::Error;

/// When a fault strikes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum At {
    /// At a tick.
    Tick(u64),
    /// At the tick that begins at this time of the flight.
    Time(Duration),
}

/// New values of plant parameters at an instant of the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// When.
    pub at: At,
    /// What, each parameter once.
    pub changes: Vec<Wanted>,
}

/// A parameter with the value that is wanted for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// The parameter.
    pub parameter: Parameter,
    /// Its value, as it was typed.
    pub value: WantedValue,
}

/// A value as it is typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WantedValue {
    /// In the unit of the parameter.
    Number(f64),
    /// That of the airframe as it was built, and so many percent of it more.
    Percent(f64),
    /// That of the airframe as it was built.
    Nominal,
}

/// Why a fault was refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FaultError {
    /// No instant.
    #[error("`{0}` has no time: write NAME=VALUE[,NAME=VALUE]@8s or ...@tick8000")]
    NoInstant(String),
    /// The instant cannot be read.
    #[error("`{0}` is no instant: write @8s, @500ms or @tick8000")]
    Instant(String),
    /// No `=`.
    #[error("`{0}` is not an assignment: write NAME=VALUE, as in rotational_drag_nm_s=0.525")]
    NoAssignment(String),
    /// The value is no number.
    #[error("{name} = `{value}` is not a number")]
    NotANumber {
        /// The parameter.
        name: String,
        /// What stands for its value.
        value: String,
    },
    /// A share without a sign.
    #[error("`{0}` has no sign: write NAME=+30% for three tenths more than nominal, NAME=-30% for less")]
    Unsigned(String),
    /// A share of nothing.
    #[error("{0} is nominally 0, of which there is no share: write a number{unit}", unit = in_unit(*.0))]
    NothingToScale(Parameter),
    /// The parameter is unknown or its value out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The plant would refuse it.
    #[error(transparent)]
    Swap(#[from] SwapError),
}

impl FromStr for Wanted {
    type Err = FaultError;

    /// Reads one `NAME=VALUE`.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, value) = text.split_once('=').ok_or_else(|| FaultError::NoAssignment(text.to_owned()))?;
        let (name, value) = (name.trim(), value.trim());
        let parameter = Parameter::from_name(name)?;
        let number = |number: &str| {
            number.parse().map_err(|_| FaultError::NotANumber { name: name.to_owned(), value: value.to_owned() })
        };
        let value = match value.strip_suffix('%') {
            Some(percent) if percent.starts_with(['+', '-']) => WantedValue::Percent(number(percent)?),
            Some(_) => return Err(FaultError::Unsigned(text.to_owned())),
            None if value == "nominal" => WantedValue::Nominal,
            None => WantedValue::Number(number(value)?),
        };
        Ok(Self { parameter, value })
    }
}

impl Wanted {
    /// The value for an airframe, in the unit of the parameter.
    ///
    /// # Errors
    /// [`FaultError::Parameter`] where it is out of the airframe's range; [`FaultError::NothingToScale`].
    pub fn of(&self, airframe: &Airframe) -> Result<(Parameter, f64), FaultError> {
        let parameter = self.parameter;
        let nominal = airframe.as_built().get(parameter);
        let value = match self.value {
            WantedValue::Number(number) => number,
            WantedValue::Percent(_) if nominal == 0.0 => return Err(FaultError::NothingToScale(parameter)),
            WantedValue::Percent(percent) => nominal * (1.0 + percent / 100.0),
            WantedValue::Nominal => nominal,
        };
        Ok((parameter, airframe.check(parameter, value)?))
    }
}

impl fmt::Display for Wanted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parameter = self.parameter;
        match self.value {
            WantedValue::Number(number) => write!(f, "{parameter}={number:?}"),
            WantedValue::Percent(percent) => write!(f, "{parameter}={percent:+?}%"),
            WantedValue::Nominal => write!(f, "{parameter}=nominal"),
        }
    }
}

/// The values that are wanted of an airframe.
///
/// # Errors
/// The first of [`Wanted::of`].
pub fn values_of(wanted: &[Wanted], airframe: &Airframe) -> Result<Vec<(Parameter, f64)>, FaultError> {
    wanted.iter().map(|wanted| wanted.of(airframe)).collect()
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (changes, at) = text.rsplit_once('@').ok_or_else(|| FaultError::NoInstant(text.to_owned()))?;
        let instant = || FaultError::Instant(at.to_owned());
        let at = match at.strip_prefix("tick") {
            Some(tick) => At::Tick(tick.parse().map_err(|_| instant())?),
            None => At::Time(humantime::parse_duration(at).map_err(|_| instant())?),
        };
        let changes = changes.split(',').map(str::parse).collect::<Result<Vec<Wanted>, _>>()?;
        check_once(&changes)?;
        Ok(Self { at, changes })
    }
}

impl Fault {
    /// As the plant of an airframe schedules it, with ticks of `period_s` [s].
    ///
    /// # Errors
    /// Those of [`Wanted::of`].
    pub fn swap(&self, period_s: f64, airframe: &Airframe) -> Result<Swap, FaultError> {
        let tick = match self.at {
            At::Tick(tick) => tick,
            At::Time(time) => (time.as_secs_f64() / period_s).round() as u64,
        };
        Ok(Swap::new(tick, &values_of(&self.changes, airframe)?)?)
    }
}

/// Refuses two values for one parameter.
pub(crate) fn check_once(wanted: &[Wanted]) -> Result<(), SwapError> {
    let again = wanted.iter().enumerate().find(|(i, one)| wanted[..*i].iter().any(|it| it.parameter == one.parameter));
    again.map_or(Ok(()), |(_, one)| Err(SwapError::Twice { parameter: one.parameter }))
}

/// A unit as it ends a hint.
fn in_unit(parameter: Parameter) -> String {
    match parameter.spec().unit {
        "" => String::new(),
        unit => format!(" in {unit}"),
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, wanted) in self.changes.iter().enumerate() {
            write!(f, "{}{wanted}", if i == 0 { "" } else { "," })?;
        }
        match self.at {
            At::Tick(tick) => write!(f, "@tick{tick}"),
            At::Time(time) => write!(f, "@{}", humantime::format_duration(time).to_string().replace(' ', "")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_instants_and_several_changes_are_read() {
        let fault: Fault = "rotational_drag_nm_s=0.525@8s".parse().unwrap();
        assert_eq!(fault.swap(0.001, &Airframe::nominal()).unwrap().tick, 8000);
        let fault: Fault = "mass_kg=0.6, rotor_efficiency_3=0.7@tick8000".parse().unwrap();
        assert_eq!(fault.at, At::Tick(8000));
        let values = values_of(&fault.changes, &Airframe::nominal()).unwrap();
        assert_eq!(values, [(Parameter::Mass, 0.6), (Parameter::RotorEfficiency3, 0.7)]);
    }

    #[test]
    fn a_share_is_of_what_the_airframe_was_built_with() {
        let mut airframe = Airframe::nominal();
        airframe.set(Parameter::Mass, 0.8).unwrap();
        let value = |text: &str| text.parse::<Wanted>().unwrap().of(&airframe).map(|(_, value)| value);
        assert_eq!(value("mass_kg=+30%"), Ok(0.52 * 1.3));
        assert_eq!(value("mass_kg=-50%"), Ok(0.26));
        assert_eq!(value("mass_kg=nominal"), Ok(0.52));
        assert_eq!(value("rotor_efficiency_2=-100%"), Ok(0.0));
        let said = |text: &str| value(text).unwrap_err().to_string();
        assert!(said("mass_kg=+1000%").contains("is out of range: allowed are 0.05 to 5.0 kg"));
        assert_eq!(
            said("gyro_noise_rad_s=+10%"),
            "gyro_noise_rad_s is nominally 0, of which there is no share: write a number in rad/s"
        );
    }

    #[test]
    fn a_fault_prints_as_it_is_typed() {
        for text in ["mass_kg=0.6@tick8000", "mass_kg=+30.5%,gyro_noise_rad_s=0.01@1m1s500ms", "mass_kg=nominal@3s"] {
            let fault: Fault = text.parse().unwrap();
            assert_eq!(fault.to_string().parse::<Fault>().unwrap(), fault, "{fault}");
        }
    }

    #[test]
    fn every_mistake_is_named() {
        for (text, said) in [
            ("mass_kg=0.6", "has no time"),
            ("mass_kg=0.6@soon", "`soon` is no instant"),
            ("mass_kg=0.6@tick-1", "`tick-1` is no instant"),
            ("mass_kg@8s", "`mass_kg` is not an assignment"),
            ("mass_kg=heavy@8s", "mass_kg = `heavy` is not a number"),
            ("mas_kg=0.6@8s", "did you mean `mass_kg`"),
            ("mass_kg=-1@8s", "mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg"),
            ("mass_kg=30%@8s", "`mass_kg=30%` has no sign: write NAME=+30%"),
            ("mass_kg=+a%@8s", "mass_kg = `+a%` is not a number"),
            ("mass_kg=0.6,mass_kg=0.7@8s", "mass_kg is given twice"),
            ("@8s", "`` is not an assignment"),
        ] {
            let swap = text.parse::<Fault>().and_then(|fault| fault.swap(0.001, &Airframe::nominal()));
            let error = swap.unwrap_err().to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
