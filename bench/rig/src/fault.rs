//! Faults as the user types them: `NAME=VALUE[,NAME=VALUE]@8s` or `@tick8000`.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use model::parameters::{Parameter, ParameterError};
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
    pub changes: Vec<(Parameter, f64)>,
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
    /// The parameter is unknown or its value out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The plant would refuse it.
    #[error(transparent)]
    Swap(#[from] SwapError),
}

/// Reads one `NAME=VALUE`.
///
/// # Errors
/// [`FaultError`] names what is wrong with it.
pub fn parse_change(text: &str) -> Result<(Parameter, f64), FaultError> {
    let (name, value) = text.split_once('=').ok_or_else(|| FaultError::NoAssignment(text.to_owned()))?;
    let (name, value) = (name.trim(), value.trim());
    let parameter = Parameter::from_name(name)?;
    let number =
        value.parse().map_err(|_| FaultError::NotANumber { name: name.to_owned(), value: value.to_owned() })?;
    Ok((parameter, parameter.check(number)?))
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
        let changes = changes.split(',').map(parse_change).collect::<Result<Vec<_>, _>>()?;
        Swap::new(0, &changes)?;
        Ok(Self { at, changes })
    }
}

impl Fault {
    /// As the plant schedules it, with ticks of `period_s` [s].
    ///
    /// # Errors
    /// [`FaultError::Swap`], which `from_str` has ruled out.
    pub fn swap(&self, period_s: f64) -> Result<Swap, FaultError> {
        let tick = match self.at {
            At::Tick(tick) => tick,
            At::Time(time) => (time.as_secs_f64() / period_s).round() as u64,
        };
        Ok(Swap::new(tick, &self.changes)?)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (parameter, value)) in self.changes.iter().enumerate() {
            write!(f, "{}{parameter}={value:?}", if i == 0 { "" } else { "," })?;
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
        assert_eq!(fault.swap(0.001).unwrap().tick, 8000);
        let fault: Fault = "mass_kg=0.6, rotor_efficiency_3=0.7@tick8000".parse().unwrap();
        assert_eq!(fault.at, At::Tick(8000));
        assert_eq!(fault.changes, [(Parameter::Mass, 0.6), (Parameter::RotorEfficiency3, 0.7)]);
    }

    #[test]
    fn a_fault_prints_as_it_is_typed() {
        for text in ["mass_kg=0.6@tick8000", "mass_kg=0.6,gyro_noise_rad_s=0.01@1m1s500ms"] {
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
            ("mass_kg=0.6,mass_kg=0.7@8s", "mass_kg is given twice"),
            ("@8s", "`` is not an assignment"),
        ] {
            let error = text.parse::<Fault>().unwrap_err().to_string();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
