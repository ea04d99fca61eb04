//! Faults of messages: `TOPIC.drop=0.1`, `inner.setpoint.delay=5`, `state.position_w_m.z.bias=0.2`.
//!
//! A topic stands for the input of every stage that receives it; the name of a stage before it for that one alone.

use std::fmt;

use model::fault::{Kind, LONGEST_DELAY, PORTS, Place, Port};
use model::role::STAGES;

use crate::fault::words::unknown;
use crate::fault::{FaultError, begin_of};

/// What is wrong with the messages of an input, or of all that a topic has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageChange {
    /// Where.
    pub inputs: Inputs,
    /// What.
    pub kind: Kind,
}

/// Which inputs are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// Those of every stage that receives a topic, by one of them.
    Topic(Port),
    /// One.
    One(Port),
}

impl Inputs {
    /// All that are meant, in the order of the stages.
    pub fn ports(self) -> impl Iterator<Item = Port> {
        PORTS.into_iter().filter(move |port| match self {
            Self::Topic(of) => port.topic() == of.topic(),
            Self::One(one) => *port == one,
        })
    }

    /// One that is meant.
    const fn any(self) -> Port {
        match self {
            Self::Topic(port) | Self::One(port) => port,
        }
    }
}

impl MessageChange {
    /// Reads a fault of messages; nothing where it names no topic.
    ///
    /// # Errors
    /// [`FaultError`] where there is no such input, field or word, or where the value is not allowed.
    pub(super) fn read(what: &str, value: Option<&str>) -> Result<Option<Self>, FaultError> {
        let mut parts: Vec<&str> = what.split('.').collect();
        let role = STAGES.into_iter().find(|role| role.name() == parts[0]);
        if role.is_some() {
            parts.remove(0);
        }
        let Some(port) = parts.first().and_then(|topic| PORTS.into_iter().find(|port| port.topic() == *topic)) else {
            return Ok(None);
        };
        let inputs = match role {
            None => Inputs::Topic(port),
            Some(role) => {
                let own = PORTS.into_iter().find(|own| own.role() == role && own.topic() == port.topic());
                Inputs::One(own.ok_or(FaultError::NoInput { role, topic: port.topic() })?)
            }
        };
        let kind = match parts[1..] {
            [word] => whole(what, word, value)?,
            [field, word] => numbers(what, place(port, field, None), word, value)?,
            [field, axis, word] => numbers(what, place(port, field, Some(axis)), word, value)?,
            _ => None,
        };
        kind.map(|kind| Some(Self { inputs, kind })).ok_or_else(|| unknown(what))
    }
}

/// What is wrong with whole messages.
fn whole(what: &str, word: &str, value: Option<&str>) -> Result<Option<Kind>, FaultError> {
    let ticks = |kind: fn(u64) -> Kind| {
        let allowed = || format!("whole ticks from 1 to {LONGEST_DELAY}, as in {what}=5");
        let kind = value.and_then(|value| value.parse().ok()).map(kind).filter(|kind| kind.is_possible());
        kind.ok_or_else(|| refused(what, value, allowed()))
    };
    Ok(Some(match word {
        "drop" => drop(what, value)?,
        "delay" => ticks(Kind::Delay)?,
        "lag" => ticks(Kind::Lag)?,
        "freeze" => without_value(what, value, Kind::Freeze)?,
        _ => return Ok(None),
    }))
}

/// What is wrong with numbers of messages.
fn numbers(what: &str, place: Option<Place>, word: &str, value: Option<&str>) -> Result<Option<Kind>, FaultError> {
    let Some(place) = place else { return Ok(None) };
    let number = |allowed: &str, kind: fn(Place, f64) -> Kind| {
        let number = value.and_then(|value| value.parse().ok());
        let kind = number.map(|number| kind(place, number)).filter(|kind| kind.is_possible());
        kind.ok_or_else(|| refused(what, value, format!("{allowed} in the unit of the field, as in {what}=0.1")))
    };
    Ok(Some(match word {
        "noise" => number("a standard deviation above 0", Kind::Noise)?,
        "bias" => number("a number other than 0", Kind::Bias)?,
        "nan" => without_value(what, value, Kind::Nan(place))?,
        _ => return Ok(None),
    }))
}

fn drop(what: &str, value: Option<&str>) -> Result<Kind, FaultError> {
    let pattern = |text: &str| {
        let (lost, of) = text.split_once('/')?;
        Some(Kind::DropEach { lost: lost.trim().parse().ok()?, of: of.trim().parse().ok()? })
    };
    let share = |text: &str| text.parse().ok().map(Kind::Drop);
    let allowed = || format!("a share above 0 and up to 1, or n/m for the first n of each m, as in {what}=0.1 or 2/5");
    let kind = value.and_then(|text| pattern(text).or_else(|| share(text))).filter(|kind| kind.is_possible());
    kind.ok_or_else(|| refused(what, value, allowed()))
}

fn without_value(what: &str, value: Option<&str>, kind: Kind) -> Result<Kind, FaultError> {
    value.map_or(Ok(kind), |_| Err(FaultError::TakesNoValue(what.to_owned())))
}

fn refused(what: &str, value: Option<&str>, allowed: String) -> FaultError {
    FaultError::Value { what: what.to_owned(), value: begin_of(value.unwrap_or_default()), allowed }
}

/// A field, and a number of it, by their names.
fn place(port: Port, field: &str, axis: Option<&str>) -> Option<Place> {
    let place = port.fields().iter().position(|known| known.name == field)?;
    let Some(axis) = axis else { return Some(Place { field: place, axis: None }) };
    let axis = port.fields()[place].axes.iter().position(|known| *known == axis)?;
    Some(Place { field: place, axis: Some(axis) })
}

impl MessageChange {
    /// What it is, without its value.
    #[must_use]
    pub fn what(&self) -> String {
        let port = self.inputs.any();
        let mut what = match self.inputs {
            Inputs::Topic(_) => port.topic().to_owned(),
            Inputs::One(_) => port.to_string(),
        };
        if let Some(Place { field, axis }) = self.kind.place() {
            let field = port.fields()[field];
            what = format!("{what}.{}", field.name);
            what.extend(axis.map(|axis| format!(".{}", field.axes[axis])));
        }
        format!("{what}.{}", self.kind.name())
    }
}

impl fmt::Display for MessageChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what())?;
        match self.kind {
            Kind::Drop(share) => write!(f, "={share:?}"),
            Kind::DropEach { lost, of } => write!(f, "={lost}/{of}"),
            Kind::Delay(ticks) | Kind::Lag(ticks) => write!(f, "={ticks}"),
            Kind::Noise(_, number) | Kind::Bias(_, number) => write!(f, "={number:?}"),
            Kind::Freeze | Kind::Nan(_) => Ok(()),
        }
    }
}
