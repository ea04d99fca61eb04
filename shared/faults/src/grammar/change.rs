//! One change of a fault: a parameter of the airframe, or a fault of the loop by the table [`FAULTS`].

use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;
use std::time::Duration;

use crate::code::FaultCode;
use crate::{
    FAULTS, FaultKind, FaultSpec, FaultValue, Kind, LiveFault, PORTS, Port, Scope, Span, ValueType,
};
use messages::parameters::{did_you_mean, nearest};
use messages::role::{CHANNEL_ROLES, Channel, Role, STAGES};

use crate::grammar::error::{FaultError, begin_of, typed};
use crate::grammar::parameter::Desired;

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
    /// Whether it is at the input of every stage that receives the topic, of which `kind` names the first.
    pub every_input: bool,
    /// Whether the fault ends; the value of `kind` means nothing then.
    pub ends: bool,
}

/// The value that ends what lasts.
const OFF: &str = "off";

/// What a fault can act on.
#[derive(Debug)]
pub(super) struct FaultTarget {
    /// `ROLE`, `cpu`, `[ROLE.]TOPIC` or `[ROLE.]TOPIC.FIELD[.AXIS]`.
    name: String,
    pub(super) scope: Scope,
    /// Place, field and axis; the kind is not set.
    code: FaultCode,
    every_input: bool,
}

pub(super) static TARGETS: LazyLock<Vec<FaultTarget>> = LazyLock::new(|| {
    let mut targets = Vec::new();
    let mut add = |name, scope, code, every_input| {
        targets.push(FaultTarget {
            name,
            scope,
            code,
            every_input,
        });
    };
    let at = |place| FaultCode {
        place,
        ..FaultCode::default()
    };
    for (place, port) in (0..).zip(PORTS) {
        let is_first = inputs_of(port.topic()).next() == Some(port);
        let topic = is_first.then(|| (port.topic().to_owned(), true));
        for (input, every_input) in topic.into_iter().chain([(port.to_string(), false)]) {
            add(input.clone(), Scope::Message, at(place), every_input);
            for (field, spec) in (0..).zip(port.fields()) {
                let name = format!("{input}.{}", spec.name);
                let code = FaultCode { field, ..at(place) };
                add(name.clone(), Scope::Number, code, every_input);
                for (axis, axis_name) in (1..).zip(spec.axes) {
                    let code = FaultCode { axis, ..code };
                    add(
                        format!("{name}.{axis_name}"),
                        Scope::Number,
                        code,
                        every_input,
                    );
                }
            }
        }
    }
    for role in STAGES {
        add(role.to_string(), Scope::Stage, at(role as u64), false);
    }
    for (axis, channel) in (1..).zip(Channel::ALL) {
        for role in CHANNEL_ROLES {
            let code = FaultCode {
                axis,
                ..at(role as u64)
            };
            add(format!("{channel}.{role}"), Scope::Stage, code, false);
        }
        let code = FaultCode { axis, ..at(0) };
        add(channel.to_string(), Scope::Channel, code, false);
    }
    add("cpu".into(), Scope::Processor, at(0), false);
    targets
});

/// The inputs of a topic, in the order of the stages.
fn inputs_of(topic: &str) -> impl Iterator<Item = Port> {
    PORTS.into_iter().filter(move |port| port.topic() == topic)
}

impl FaultTarget {
    fn named(name: &str) -> Option<&'static Self> {
        TARGETS.iter().find(|target| target.name == name)
    }

    /// The fault of a kind with a value; `None` if that is out of range, or the target cannot have the fault.
    pub(super) fn change(&self, spec: &FaultSpec, value: FaultValue) -> Option<LoopChange> {
        let code = FaultCode {
            what: spec.id as u64,
            first: value.0[0],
            second: value.0[1],
            ..self.code
        };
        code.fault().map(|fault| LoopChange {
            kind: fault.kind,
            every_input: self.every_input,
            ends: false,
        })
    }
}

impl FromStr for Change {
    type Err = FaultError;

    /// Reads one `WHAT=VALUE`, or one `WHAT` that takes none.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        if text.contains('@') {
            let why = "@ says when a planned fault begins (--fault): leave it out";
            return Err(FaultError::fault(format!("{text}: {why}")));
        }
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
    pub const fn wanted(&self) -> Option<Desired> {
        match self {
            Self::Parameter(wanted) => Some(*wanted),
            Self::Loop(_) => None,
        }
    }

    /// Whether it lasts as long as its ticks say.
    pub const fn lasts(&self) -> bool {
        match self {
            Self::Parameter(_) => false,
            Self::Loop(change) => !change.ends && !change.kind.spec().is_once(),
        }
    }

    /// Its name, without its value.
    pub fn what(&self) -> String {
        match self {
            Self::Parameter(wanted) => wanted.parameter.to_string(),
            Self::Loop(change) => change.what(),
        }
    }

    /// The faults of the loop, input by input, and whether each ends; none of a parameter.
    pub fn kinds(&self) -> Vec<(FaultKind, bool)> {
        let Self::Loop(LoopChange {
            kind,
            every_input,
            ends,
        }) = *self
        else {
            return Vec::new();
        };
        match kind.port().filter(|_| every_input) {
            Some(port) => inputs_of(port.topic())
                .map(|port| (kind.at(port), ends))
                .collect(),
            None => vec![(kind, ends)],
        }
    }

    /// The same as faults of these ticks.
    pub fn faults(&self, requested: Span) -> impl Iterator<Item = LiveFault> {
        self.kinds().into_iter().map(move |(kind, ends)| {
            let fault = LiveFault {
                kind,
                ends,
                span: requested,
            };
            let span = fault.span_from(requested);
            LiveFault { span, ..fault }
        })
    }

    /// Refuses an end for what has none.
    pub(super) fn check_end(&self) -> Result<(), FaultError> {
        match self {
            Self::Parameter(Desired { parameter, .. }) => Err(FaultError::parameter(format!(
                "{parameter} holds until it is changed again: leave the end out, and plan the change back, as in \
                 {parameter}=nominal@9s"
            ))),
            Self::Loop(_) if self.lasts() => Ok(()),
            Self::Loop(change) => {
                let what = if change.ends {
                    change.to_string()
                } else {
                    change.what()
                };
                Err(FaultError::fault(format!(
                    "{what} happens once, at an instant: leave the end out"
                )))
            }
        }
    }

    /// The change that makes the first of some faults, with those behind it that are of the same topic's other inputs;
    /// and how many these are.
    pub(crate) fn joined(faults: &[LiveFault], first: &LiveFault) -> (Self, usize) {
        let alone = LoopChange {
            kind: first.kind,
            every_input: false,
            ends: first.ends,
        };
        let every = Self::Loop(LoopChange {
            every_input: true,
            ..alone
        });
        let is_like = |(fault, (kind, ends)): (&LiveFault, (FaultKind, bool))| {
            (fault.kind, fault.ends, fault.span) == (kind, ends, first.span)
        };
        let kinds = every.kinds();
        if kinds.len() > 1
            && faults.len() >= kinds.len()
            && faults.iter().zip(kinds.clone()).all(is_like)
        {
            return (every, kinds.len());
        }
        (Self::Loop(alone), 1)
    }
}

impl LoopChange {
    fn read(what: &str, value: Option<&str>) -> Result<Self, FaultError> {
        let parts = what.rsplit_once('.');
        let (target, name) = parts
            .and_then(|(target, name)| Some((FaultTarget::named(target)?, name)))
            .ok_or_else(|| unknown(what))?;
        let specs: Vec<&FaultSpec> = FaultSpec::named(target.scope, name).collect();
        let spec = *specs.first().ok_or_else(|| unknown(what))?;
        let any = target.change(spec, spec.value.example().0).ok_or_else(|| {
            FaultError::fault(format!(
                "{what}: a flight ends with its plant; plant.stop=20ms stops it for a while"
            ))
        })?;
        match value {
            Some(OFF) if spec.is_once() => Err(FaultError::fault(format!(
                "{what} happens once: there is nothing to end"
            ))),
            Some(OFF) => Ok(Self { ends: true, ..any }),
            None if spec.value == ValueType::None => Ok(any),
            Some(value) if spec.value == ValueType::None => Err(FaultError::fault(format!(
                "{what} takes no value: leave out `={value}`"
            ))),
            _ => {
                let value = value.unwrap_or_default();
                let mut read = specs.iter();
                let read =
                    read.find_map(|spec| target.change(spec, read_value(spec.value, value)?));
                let allowed = |spec: &&FaultSpec| {
                    let (_, example) = spec.value.example();
                    format!("{}, as in {what}={example}", spec.value.range())
                };
                read.ok_or_else(|| {
                    let allowed: Vec<String> = specs.iter().map(allowed).collect();
                    let (value, allowed) = (begin_of(value), allowed.join(", or "));
                    FaultError::fault(format!("{what} = `{value}`: write {allowed}"))
                })
            }
        }
    }

    /// Its name, without its value.
    fn what(&self) -> String {
        let of = FaultCode::of(&LiveFault {
            kind: self.kind,
            ends: false,
            span: Span::new(0, 1),
        });
        let spec = self.kind.spec();
        let target = TARGETS.iter().find(|target| {
            let code = target.code;
            (target.scope, target.every_input) == (spec.kind.scope(), self.every_input)
                && (code.place, code.field, code.axis) == (of.place, of.field, of.axis)
        });
        let target = target.map_or("", |target| &target.name);
        format!("{target}.{}", spec.name)
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
        let FaultValue([first, second]) = self.kind.value;
        let time = |ns| typed(Duration::from_nanos(ns));
        match self.kind.spec().value {
            ValueType::None => Ok(()),
            ValueType::Share | ValueType::Positive(_) | ValueType::NotZero => {
                write!(f, "={:?}", self.kind.value.number())
            }
            ValueType::Pattern => write!(f, "={first}/{second}"),
            ValueType::Integer { .. } => write!(f, "={first}"),
            ValueType::TimeRange if first != second => {
                write!(f, "={}..{}", time(first), time(second))
            }
            ValueType::Time | ValueType::TimeRange => write!(f, "={}", time(first)),
        }
    }
}

/// A value as it is typed; `None` if it cannot be read.
fn read_value(of: ValueType, text: &str) -> Option<FaultValue> {
    let time = |text: &str| {
        let time = humantime::parse_duration(text.trim()).ok()?;
        u64::try_from(time.as_nanos()).ok()
    };
    Some(FaultValue(match of {
        ValueType::None => [0, 0],
        ValueType::Share | ValueType::Positive(_) | ValueType::NotZero => {
            [text.parse::<f64>().ok()?.to_bits(), 0]
        }
        ValueType::Pattern => {
            let (lost, of) = text.split_once('/')?;
            [lost.trim().parse().ok()?, of.trim().parse().ok()?]
        }
        ValueType::Integer { .. } => [text.parse().ok()?, 0],
        ValueType::Time => [time(text)?, 0],
        ValueType::TimeRange => {
            let (least, most) = text.split_once("..").unwrap_or((text, text));
            [time(least)?, time(most)?]
        }
    }))
}

/// All names of faults of the loop, except those of single numbers of a field.
pub(super) fn known() -> impl Iterator<Item = String> {
    let is_field = |target: &&FaultTarget| target.code.axis == 0 || target.scope == Scope::Channel;
    let all = TARGETS.iter().filter(is_field).flat_map(|target| {
        let of_target = FAULTS
            .iter()
            .filter(|spec| spec.kind.scope() == target.scope);
        of_target.map(move |spec| (target, spec))
    });
    let is_possible = |(target, spec): &(&FaultTarget, &FaultSpec)| {
        target.change(spec, spec.value.example().0).is_some()
    };
    all.filter(is_possible)
        .map(|(target, spec)| format!("{}.{}", target.name, spec.name))
}

fn unknown(name: &str) -> FaultError {
    let (of, rest) = name.split_once('.').unwrap_or((name, ""));
    let role = STAGES.into_iter().find(|role| role.name() == of);
    let topic = rest
        .split('.')
        .next()
        .and_then(|topic| inputs_of(topic).next());
    if let (Some(role), Some(port)) = (role, topic)
        && Port::of(role, port.topic()).is_none()
    {
        let inputs = PORTS.into_iter().filter(|port| port.role() == role);
        let inputs: Vec<String> = inputs.map(|port| format!("`{}`", port.topic())).collect();
        return FaultError::fault(format!(
            "{role} does not receive `{}`: it receives {}",
            port.topic(),
            inputs.join(" and ")
        ));
    }
    let known: Vec<String> = known().collect();
    let like = || did_you_mean(nearest(name, known.iter().map(String::as_str)));
    FaultError::fault(format!(
        "unknown fault `{name}`{}",
        hint(name).unwrap_or_else(like)
    ))
}

/// What is wrong with a name of which each part is known.
fn hint(name: &str) -> Option<String> {
    let (rest, kind) = name.rsplit_once('.')?;
    match FAULTS.iter().find(|spec| spec.name == kind)?.kind {
        Kind::Stage(of_stage) if rest == "record" => {
            let stages = STAGES.into_iter().filter(|role| of_stage.acts_on(*role));
            let stages: Vec<&str> = stages.map(Role::name).collect();
            return Some(format!(
                ": the recorder is no stage; `STAGE.{kind}` is for {}",
                stages.join(", ")
            ));
        }
        Kind::Number(_) => {}
        Kind::Message(_) | Kind::Stage(_) | Kind::Processor(_) | Kind::Channel(_) => return None,
    }
    let fields = |target: &FaultTarget| PORTS[target.code.place as usize].fields();
    if let Some(target) = FaultTarget::named(rest).filter(|target| target.scope == Scope::Message) {
        let field = fields(target).first()?.name;
        return Some(format!(
            ": it is a fault of a number: name which, as in `{rest}.{field}.{kind}`"
        ));
    }
    let (field, _axis) = rest.rsplit_once('.')?;
    let target = FaultTarget::named(field)
        .filter(|target| target.scope == Scope::Number && target.code.axis == 0)?;
    let field = &fields(target)[target.code.field as usize];
    Some(match field.axes {
        [] => format!(": `{}` is one number, without axes", field.name),
        axes => format!(": the axes of `{}` are {}", field.name, axes.join(", ")),
    })
}
