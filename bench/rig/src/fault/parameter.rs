//! Faults of the airframe: a parameter, and the value that is wanted for it.
//!
//! A value is a number, `nominal`, or a share of that which is added, as in `+30%`. Nominal is what the airframe was
//! built with, so what a value is, and whether it is in range, shows only with an airframe. `~2s` makes a ramp of it,
//! from the value that holds at the instant.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use messages::parameters::{Airframe, Parameter};
use plant::{SwapError, Target};

use crate::fault::error::{FaultError, begin_of, typed};

/// A parameter with the value that is wanted for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Desired {
    pub parameter: Parameter,
    /// Its value, as it was typed.
    pub value: RequestedValue,
    /// How long it takes to get there; `None` is at once.
    pub over: Option<Duration>,
}

/// The longest ramp: as long as the longest flight.
const LONGEST_RAMP: Duration = Duration::from_secs(30 * 86_400);

/// A value as it is typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RequestedValue {
    /// In the unit of the parameter.
    Number(f64),
    /// That of the airframe as it was built, and so many percent of it more.
    Percent(f64),
    /// That of the airframe as it was built.
    Nominal,
}

impl FromStr for Desired {
    type Err = FaultError;

    /// Reads one `NAME=VALUE`.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| FaultError::NoAssignment(text.to_owned()))?;
        let (name, value) = (name.trim(), value.trim());
        let parameter = Parameter::from_name(name)?;
        let (value, over) = match value.split_once('~') {
            Some((value, time)) => (value.trim(), Some(ramp_time(name, value, time.trim())?)),
            None => (value, None),
        };
        let number = |number: &str| {
            number.parse().map_err(|_| FaultError::NotANumber {
                name: name.to_owned(),
                value: begin_of(value),
            })
        };
        let share = |percent: &str| {
            let is_share = |percent: &f64| percent.is_finite();
            let wrong = || FaultError::NotANumber {
                name: name.to_owned(),
                value: begin_of(value),
            };
            number(percent).ok().filter(is_share).ok_or_else(wrong)
        };
        let value = match value.strip_suffix('%') {
            Some(percent) if percent.starts_with(['+', '-']) => {
                RequestedValue::Percent(share(percent)?)
            }
            Some(_) => return Err(FaultError::Unsigned(text.to_owned())),
            None if value == "nominal" => RequestedValue::Nominal,
            None => RequestedValue::Number(number(value)?),
        };
        Ok(Self {
            parameter,
            value,
            over,
        })
    }
}

fn ramp_time(name: &str, value: &str, time: &str) -> Result<Duration, FaultError> {
    let wrong = |why: String| {
        let (name, value, time) = (name.to_owned(), value.to_owned(), time.to_owned());
        Err(FaultError::RampTime {
            name,
            value,
            time,
            why,
        })
    };
    match humantime::parse_duration(time) {
        _ if time.starts_with('-') => wrong("a time is not negative".into()),
        // humantime reads a bare 0 as well.
        Ok(Duration::ZERO) => wrong("it is no time; without ~ the change is at once".into()),
        Ok(over) if over > LONGEST_RAMP => {
            wrong("it is longer than the longest flight, 30 days".into())
        }
        Ok(over) => Ok(over),
        Err(e) => wrong(e.to_string().trim_end().to_owned()),
    }
}

impl Desired {
    /// The value for an airframe, in the unit of the parameter.
    pub fn of(&self, airframe: &Airframe) -> Result<(Parameter, f64), FaultError> {
        let parameter = self.parameter;
        let nominal = airframe.as_built().get(parameter);
        let value = match self.value {
            RequestedValue::Number(number) => number,
            RequestedValue::Percent(_) if nominal == 0.0 => {
                return Err(FaultError::NothingToScale(parameter));
            }
            RequestedValue::Percent(percent) => nominal * (1.0 + percent / 100.0),
            RequestedValue::Nominal => nominal,
        };
        Ok((parameter, airframe.check(parameter, value)?))
    }

    /// The same with the steps that it takes in ticks of `period_s` [s], at least one.
    pub fn target(&self, airframe: &Airframe, period_s: f64) -> Result<Target, FaultError> {
        let (parameter, value) = self.of(airframe)?;
        let steps = self.over.map_or(1, |over| {
            (over.as_secs_f64() / period_s).round().max(1.0) as u64
        });
        Ok(Target {
            parameter,
            value,
            steps,
        })
    }
}

impl fmt::Display for Desired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parameter = self.parameter;
        match self.value {
            RequestedValue::Number(number) => write!(f, "{parameter}={number:?}"),
            RequestedValue::Percent(percent) => write!(f, "{parameter}={percent:+}%"),
            RequestedValue::Nominal => write!(f, "{parameter}=nominal"),
        }?;
        self.over
            .map_or(Ok(()), |over| write!(f, "~{}", typed(over)))
    }
}

/// What is wanted of an airframe, in ticks of `period_s` [s].
pub fn targets_of(
    wanted: &[Desired],
    airframe: &Airframe,
    period_s: f64,
) -> Result<Vec<Target>, FaultError> {
    wanted
        .iter()
        .map(|wanted| wanted.target(airframe, period_s))
        .collect()
}

/// Refuses two values for one parameter.
pub(crate) fn check_once(wanted: &[Desired]) -> Result<(), SwapError> {
    let again = wanted
        .iter()
        .enumerate()
        .find(|(i, one)| wanted[..*i].iter().any(|it| it.parameter == one.parameter));
    again.map_or(Ok(()), |(_, one)| {
        Err(SwapError::Twice {
            parameter: one.parameter,
        })
    })
}
