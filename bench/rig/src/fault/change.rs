//! One change of a fault: a parameter of the airframe, or a fault of the loop by the table [`FAULTS`].

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use messages::fault::code::{FAULTS, FaultCode, FaultSpec, Scope, ValueType};
use messages::fault::live::{FaultKind, LiveFault};
use messages::fault::{PORTS, Place, Port, Span};
use messages::parameters::{did_you_mean, nearest};
use messages::role::{Role, STAGES};

use crate::fault::error::{FaultError, begin_of, typed};
use crate::fault::parameter::Desired;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// A parameter of the airframe has another value.
    Parameter(Desired),
    /// Messages, a stage or the loops' processor.
    Loop(LoopChange),
}

/// A fault of the loop, or its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopChange {
    pub kind: FaultKind,
    /// Whether it is at the input of every stage that receives the topic, of which `kind` names one.
    pub every_input: bool,
    /// Whether it ends; the numbers of `kind` mean nothing then.
    pub ends: bool,
}

/// The value that ends what lasts.
const OFF: &str = "off";

/// What the names of [`Scope::Processor`] begin with.
const PROCESSOR: &str = "cpu";

impl FromStr for Change {
    type Err = FaultError;

    /// Reads one `WHAT=VALUE`, or one `WHAT` that takes none.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (what, value) = match text.split_once('=') {
            Some((what, value)) => (what.trim(), Some(value.trim())),
            None => (text.trim(), None),
        };
        if !what.contains('.') {
            return text.parse().map(Self::Parameter);
        }
        LoopChange::read(what, value).map(Self::Loop)
    }
}

impl Change {
    #[must_use]
    pub const fn wanted(&self) -> Option<Desired> {
        match self {
            Self::Parameter(wanted) => Some(*wanted),
            Self::Loop(_) => None,
        }
    }

    /// Whether it lasts as long as its ticks say.
    #[must_use]
    pub const fn lasts(&self) -> bool {
        match self {
            Self::Parameter(_) => false,
            Self::Loop(change) => !change.ends && !change.kind.is_once(),
        }
    }

    /// Its name, without its value.
    #[must_use]
    pub fn what(&self) -> String {
        match self {
            Self::Parameter(wanted) => wanted.parameter.to_string(),
            Self::Loop(change) => change.what(),
        }
    }

    /// The faults of the loop, input by input, and whether each ends; none of a parameter.
    #[must_use]
    pub fn kinds(&self) -> Vec<(FaultKind, bool)> {
        let Self::Loop(change) = self else {
            return Vec::new();
        };
        let kinds: Vec<FaultKind> = match change.kind {
            FaultKind::Messages { port, kind } if change.every_input => inputs_of(port.topic())
                .map(|port| FaultKind::Messages { port, kind })
                .collect(),
            kind => vec![kind],
        };
        kinds.into_iter().map(|kind| (kind, change.ends)).collect()
    }

    /// The same as faults of these ticks.
    pub fn faults(&self, requested: Span) -> impl Iterator<Item = LiveFault> {
        self.kinds().into_iter().map(move |(trouble, ends)| {
            let fault = LiveFault {
                trouble,
                ends,
                span: requested,
            };
            LiveFault {
                span: fault.span_from(requested),
                ..fault
            }
        })
    }

    /// The change that makes the first of some faults, with those behind it that are of the same topic's other inputs;
    /// and how many these are.
    pub(super) fn joined(faults: &[LiveFault], first: &LiveFault) -> (Self, usize) {
        let LiveFault {
            trouble: kind,
            ends,
            ..
        } = *first;
        let mut change = LoopChange {
            kind,
            every_input: false,
            ends,
        };
        let mut length = 1;
        if let FaultKind::Messages { port, kind } = kind {
            let all: Vec<LiveFault> = inputs_of(port.topic())
                .map(|port| LiveFault {
                    trouble: FaultKind::Messages { port, kind },
                    ..*first
                })
                .collect();
            change.every_input = faults.starts_with(&all);
            length = if change.every_input { all.len() } else { 1 };
        }
        (Self::Loop(change), length)
    }
}

/// The inputs of a topic, in the order of the stages.
fn inputs_of(topic: &str) -> impl Iterator<Item = Port> {
    PORTS.into_iter().filter(move |port| port.topic() == topic)
}

/// A name that was read: what it acts on, and the name of its kind.
struct Name<'a> {
    scope: Scope,
    name: &'a str,
    /// The stage or the input, and the number of it; the kind is not set.
    code: FaultCode,
    every_input: bool,
}

impl LoopChange {
    fn read(what: &str, value: Option<&str>) -> Result<Self, FaultError> {
        let Name {
            scope,
            name,
            code,
            every_input,
        } = Name::read(what)?;
        let ends = value == Some(OFF);
        let with = |spec: &FaultSpec, [first, second]: [u64; 2]| {
            let code = FaultCode {
                what: spec.what as u64,
                first,
                second,
                ..code
            };
            code.fault().map(|fault| Self {
                kind: fault.trouble,
                every_input,
                ends,
            })
        };
        let mut specs = FaultSpec::named(scope, name).peekable();
        let Some(spec) = specs.peek().copied() else {
            return Err(unknown(what));
        };
        if ends {
            if spec.is_once() {
                return Err(FaultError::NotLasting(what.to_owned()));
            }
            return with(spec, any_value(spec.value)).ok_or_else(|| unknown(what));
        }
        if spec.value == ValueType::None {
            if value.is_some() {
                return Err(FaultError::TakesNoValue(what.to_owned()));
            }
            return with(spec, [0, 0]).ok_or(FaultError::PlantKilled);
        }
        let value = value.unwrap_or_default();
        specs
            .find_map(|spec| with(spec, read_value(spec.value, value)?))
            .ok_or_else(|| FaultError::Value {
                what: what.to_owned(),
                value: begin_of(value),
                allowed: spec.allowed().replace("WHAT", what),
            })
    }

    /// Its name, without its value.
    fn what(&self) -> String {
        let code = self.code();
        let Some(spec) = FaultSpec::of(code.what) else {
            return String::new();
        };
        let of = match self.kind {
            FaultKind::Messages { port, kind } => {
                let input = match self.every_input {
                    true => port.topic().to_owned(),
                    false => port.to_string(),
                };
                match kind.place() {
                    None => input,
                    Some(Place { field, axis }) => {
                        let field = port.fields()[field];
                        let axis = axis.map(|axis| format!(".{}", field.axes[axis]));
                        format!("{input}.{}{}", field.name, axis.unwrap_or_default())
                    }
                }
            }
            FaultKind::Late { role, .. }
            | FaultKind::Stop { role, .. }
            | FaultKind::Kill { role } => role.to_string(),
            FaultKind::Hog { .. } | FaultKind::Load { .. } => PROCESSOR.to_owned(),
        };
        format!("{of}.{}", spec.name)
    }

    fn code(&self) -> FaultCode {
        FaultCode::of(&LiveFault {
            trouble: self.kind,
            ends: false,
            span: Span { from: 0, to: 1 },
        })
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(wanted) => wanted.fmt(f),
            Self::Loop(change) => change.fmt(f),
        }
    }
}

impl fmt::Display for LoopChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what())?;
        if self.ends {
            return write!(f, "={OFF}");
        }
        let FaultCode {
            what,
            first,
            second,
            ..
        } = self.code();
        let time = |ns| typed(Duration::from_nanos(ns));
        match FaultSpec::of(what).map_or(ValueType::None, |spec| spec.value) {
            ValueType::None => Ok(()),
            ValueType::Share | ValueType::Number => write!(f, "={:?}", f64::from_bits(first)),
            ValueType::Pattern => write!(f, "={first}/{second}"),
            ValueType::Integer => write!(f, "={first}"),
            ValueType::TimeRange if first != second => {
                write!(f, "={}..{}", time(first), time(second))
            }
            ValueType::Time | ValueType::TimeRange => write!(f, "={}", time(first)),
        }
    }
}

/// The two numbers of a value, as [`FaultCode`] has them; none where it cannot be read.
fn read_value(of: ValueType, text: &str) -> Option<[u64; 2]> {
    let time = |text: &str| {
        let time = humantime::parse_duration(text.trim()).ok()?;
        u64::try_from(time.as_nanos()).ok()
    };
    Some(match of {
        ValueType::None => [0, 0],
        ValueType::Share | ValueType::Number => [text.parse::<f64>().ok()?.to_bits(), 0],
        ValueType::Pattern => {
            let (lost, of) = text.split_once('/')?;
            [lost.trim().parse().ok()?, of.trim().parse().ok()?]
        }
        ValueType::Integer => [text.parse().ok()?, 0],
        ValueType::Time => [time(text)?, 0],
        ValueType::TimeRange => {
            let (least, most) = text.split_once("..").unwrap_or((text, text));
            [time(least)?, time(most)?]
        }
    })
}

/// A value that every fault of the type may have.
const fn any_value(of: ValueType) -> [u64; 2] {
    match of {
        ValueType::Share | ValueType::Number => [1.0_f64.to_bits(), 0],
        _ => [1, 1],
    }
}

impl<'a> Name<'a> {
    /// Reads `ROLE.NAME`, `cpu.NAME`, `[ROLE.]TOPIC.NAME` or `[ROLE.]TOPIC.FIELD[.AXIS].NAME`.
    fn read(what: &'a str) -> Result<Self, FaultError> {
        let (of, name) = what.rsplit_once('.').ok_or_else(|| unknown(what))?;
        let here = |scope, code, every_input| {
            Ok(Self {
                scope,
                name,
                code,
                every_input,
            })
        };
        if of == PROCESSOR {
            return here(Scope::Processor, FaultCode::default(), false);
        }
        let mut parts: Vec<&str> = of.split('.').collect();
        let role = STAGES.into_iter().find(|role| role.name() == parts[0]);
        if let Some(role) = role {
            parts.remove(0);
            if parts.is_empty() {
                let code = FaultCode {
                    place: role as u64,
                    ..FaultCode::default()
                };
                return here(Scope::Stage, code, false);
            }
        }
        let topic = parts.first().and_then(|topic| inputs_of(topic).next());
        let first = topic.ok_or_else(|| unknown(what))?;
        let port = match role {
            None => first,
            Some(role) => Port::of(role, first.topic()).ok_or(FaultError::NoInput {
                role,
                topic: first.topic(),
            })?,
        };
        let place = PORTS.iter().position(|it| *it == port).unwrap_or_default();
        let code = FaultCode {
            place: place as u64,
            ..FaultCode::default()
        };
        let field_of = |name: &str| {
            let field = port.fields().iter().position(|field| field.name == name);
            field.ok_or_else(|| unknown(what))
        };
        match parts[1..] {
            [] => here(Scope::Message, code, role.is_none()),
            [field] => {
                let field = field_of(field)? as u64;
                here(Scope::Number, FaultCode { field, ..code }, role.is_none())
            }
            [field, axis] => {
                let field = field_of(field)?;
                let mut axes = port.fields()[field].axes.iter();
                let axis = axes.position(|known| *known == axis);
                let code = FaultCode {
                    field: field as u64,
                    axis: axis.ok_or_else(|| unknown(what))? as u64 + 1,
                    ..code
                };
                here(Scope::Number, code, role.is_none())
            }
            _ => Err(unknown(what)),
        }
    }
}

/// All names of faults of the loop, those of single numbers left out.
pub(super) fn known() -> Vec<String> {
    let mut known: Vec<String> = Vec::new();
    for port in PORTS {
        for input in [port.topic().to_owned(), port.to_string()] {
            known.extend(FaultSpec::names(Scope::Message).map(|name| format!("{input}.{name}")));
            for field in port.fields() {
                let names = FaultSpec::names(Scope::Number);
                known.extend(names.map(|name| format!("{input}.{}.{name}", field.name)));
            }
        }
    }
    for role in STAGES {
        let names = FaultSpec::names(Scope::Stage).filter(|name| is_possible(role, name));
        known.extend(names.map(|name| format!("{role}.{name}")));
    }
    known.extend(FaultSpec::names(Scope::Processor).map(|name| format!("{PROCESSOR}.{name}")));
    known
}

/// A flight ends with its plant.
fn is_possible(role: Role, name: &str) -> bool {
    (role, name) != (Role::Plant, "kill")
}

fn unknown(name: &str) -> FaultError {
    let known = known();
    let like = || did_you_mean(nearest(name, known.iter().map(String::as_str)));
    FaultError::Unknown {
        name: name.to_owned(),
        hint: hint(name).unwrap_or_else(like),
    }
}

/// What is wrong with a name of which each part is known.
fn hint(name: &str) -> Option<String> {
    let (rest, kind) = name.rsplit_once('.')?;
    let scope = FAULTS.iter().find(|spec| spec.name == kind)?.scope;
    if rest == "record" && scope == Scope::Stage {
        let stages: Vec<&str> = STAGES
            .into_iter()
            .filter(|role| is_possible(*role, kind))
            .map(Role::name)
            .collect();
        return Some(format!(
            ": the recorder is no stage; `STAGE.{kind}` is for {}",
            stages.join(", ")
        ));
    }
    if scope != Scope::Number {
        return None;
    }
    let inputs = PORTS
        .into_iter()
        .flat_map(|port| [(port, port.topic().to_owned()), (port, port.to_string())]);
    inputs.into_iter().find_map(|(port, input)| {
        let field = port.fields().first()?.name;
        if rest == input {
            return Some(format!(
                ": it is a fault of a number: name which, as in `{input}.{field}.{kind}`"
            ));
        }
        let (field, _axis) = rest
            .strip_prefix(&input)?
            .strip_prefix('.')?
            .split_once('.')?;
        let axes = port.fields().iter().find(|known| known.name == field)?.axes;
        Some(match axes {
            [] => format!(": `{field}` is one number, without axes"),
            axes => format!(": the axes of `{field}` are {}", axes.join(", ")),
        })
    })
}
