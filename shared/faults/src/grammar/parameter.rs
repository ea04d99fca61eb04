//! Faults of the airframe: a parameter, and the value that is wanted for it.
//!
//! A value is a number, `nominal`, or a share of that which is added, as in `+30%`. Nominal is what the airframe was
//! built with, so what a value is, and whether it is in range, shows only with an airframe. `~2s` makes a ramp of it,
//! from the value that holds at the instant.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use crate::swap::{SwapError, Target};
use messages::parameters::{Airframe, Parameter};

use crate::grammar::error::{FaultError, begin_of, typed};

/// A parameter with the value that is wanted for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Desired {
    pub parameter: Parameter,
    pub value: RequestedValue,
    /// Length of the ramp; `None` is at once.
    pub over: Option<Duration>,
}

/// The longest ramp: as long as the longest flight.
const LONGEST_RAMP: Duration = Duration::from_secs(30 * 86_400);

/// A value as it is typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RequestedValue {
    /// In the unit of the parameter.
    Number(f64),
    /// This many percent more than nominal.
    Percent(f64),
    /// That of the airframe as it was built.
    Nominal,
}

impl FromStr for Desired {
    type Err = FaultError;

    /// Reads one `NAME=VALUE`.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, value) = text.split_once('=').ok_or_else(|| {
            FaultError::parameter(format!(
                "`{text}` is not an assignment: write NAME=VALUE, as in rotational_drag_nm_s=0.525"
            ))
        })?;
        let (name, value) = (name.trim(), value.trim());
        let parameter = Parameter::from_name(name)?;
        let (value, over) = match value.split_once('~') {
            Some((value, time)) => (value.trim(), Some(ramp_time(name, value, time.trim())?)),
            None => (value, None),
        };
        let not_a_number =
            || FaultError::parameter(format!("{name} = `{}` is not a number", begin_of(value)));
        let value = match value.strip_suffix('%') {
            Some(percent) if percent.starts_with(['+', '-']) => {
                let percent = percent
                    .parse()
                    .ok()
                    .filter(|percent: &f64| percent.is_finite());
                RequestedValue::Percent(percent.ok_or_else(not_a_number)?)
            }
            Some(_) => {
                return Err(FaultError::parameter(format!(
                    "`{text}` has no sign: write NAME=+30% for three tenths more than nominal, NAME=-30% for less"
                )));
            }
            None if value == "nominal" => RequestedValue::Nominal,
            None => RequestedValue::Number(value.parse().map_err(|_| not_a_number())?),
        };
        Ok(Self {
            parameter,
            value,
            over,
        })
    }
}

fn ramp_time(name: &str, value: &str, time: &str) -> Result<Duration, FaultError> {
    let why = match humantime::parse_duration(time) {
        _ if time.starts_with('-') => "a time is not negative".into(),
        // humantime reads a bare 0 as well.
        Ok(Duration::ZERO) => "it is no time; without ~ the change is at once".into(),
        Ok(over) if over <= LONGEST_RAMP => return Ok(over),
        Ok(_) => "it is longer than the longest flight, 30 days".into(),
        Err(e) => e.to_string(),
    };
    Err(FaultError::parameter(format!(
        "{name}: a ramp of `{time}`: {}; write the time that it takes, as in {name}={value}~2s or ~500ms",
        why.trim_end()
    )))
}

impl Desired {
    /// The value for an airframe, in the unit of the parameter.
    pub fn of(&self, airframe: &Airframe) -> Result<(Parameter, f64), FaultError> {
        let parameter = self.parameter;
        let nominal = airframe.as_built().get(parameter);
        let value = match self.value {
            RequestedValue::Number(number) => number,
            RequestedValue::Percent(_) if nominal == 0.0 => {
                let unit = match parameter.spec().unit {
                    "" => String::new(),
                    unit => format!(" in {unit}"),
                };
                return Err(FaultError::parameter(format!(
                    "{parameter} is nominally 0, of which there is no share: write a number{unit}"
                )));
            }
            RequestedValue::Percent(percent) => nominal * (1.0 + percent / 100.0),
            RequestedValue::Nominal => nominal,
        };
        Ok((parameter, airframe.check(parameter, value)?))
    }

    /// The same with the steps that it takes in ticks of `period_s` [s], at least one.
    pub fn target(&self, airframe: &Airframe, period_s: f64) -> Result<Target, FaultError> {
        let (parameter, value) = self.of(airframe)?;
        let ticks = |over: Duration| (over.as_secs_f64() / period_s).round().max(1.0) as u64;
        Ok(Target {
            parameter,
            value,
            steps: self.over.map_or(1, ticks),
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
pub fn check_once(wanted: &[Desired]) -> Result<(), SwapError> {
    for (place, Desired { parameter, .. }) in wanted.iter().enumerate() {
        let parameter = *parameter;
        if wanted[..place].iter().any(|it| it.parameter == parameter) {
            return Err(SwapError::Twice { parameter });
        }
    }
    Ok(())
}
