//! Why a fault was refused.

use std::time::Duration;

use messages::fault::live::{MOST_LIVE, NOTICE_TICKS};
use messages::fault::{MOST, Port};
use messages::parameters::{Parameter, ParameterError};
use messages::role::Role;
use plant::SwapError;
use thiserror::Error;

#[derive(Clone, Debug, PartialEq, Error)]
pub enum FaultError {
    #[error("`{0}` has no time: write it behind, as in {0}@8s or {0}@tick8000")]
    NoInstant(String),
    #[error("`{0}` has several instants: give --fault once for each")]
    SeveralInstants(String),
    #[error("`{0}` is no instant: write @8s, @500ms or @tick8000, and ..9s behind it for an end")]
    Instant(String),
    #[error(
        "`{fault}` ends at tick {to}, and begins at tick {from}: write the earlier one first, as in @8s..9s"
    )]
    Order { fault: String, from: u64, to: u64 },
    /// A parameter that would change back by itself.
    #[error(
        "{0} holds until it is changed again: leave the end out, and plan the change back, as in {0}=nominal@9s"
    )]
    ParameterEnds(Parameter),
    /// An end for what happens once.
    #[error("{0} happens once, at an instant: leave the end out")]
    StageEnds(String),
    /// No `=`.
    #[error("`{0}` is not an assignment: write NAME=VALUE, as in rotational_drag_nm_s=0.525")]
    NoAssignment(String),
    #[error("unknown fault `{name}`{hint}")]
    Unknown {
        name: String,
        /// What is amiss with it where that can be told, or the known name most like it.
        hint: String,
    },
    /// The stage has no such input.
    #[error("{role} does not receive `{topic}`: {}", inputs(*role))]
    NoInput { role: Role, topic: &'static str },
    /// A fault of the processor, of a flight that needs none.
    #[error(
        "{0}: ticks of a simulation need no processor: leave it out, or fly it with `ironbird fly`"
    )]
    Processor(&'static str),
    /// What happens once does not end.
    #[error("{0} happens once: there is nothing to end")]
    NotLasting(String),
    /// Nothing strikes that could be ended.
    #[error("{0}=off: it does not strike then or later")]
    NothingToEnd(String),
    /// The flight is over before it.
    #[error(
        "{0} never strikes: the flight ends before, and all stages are told {NOTICE_TICKS} ticks ahead"
    )]
    AfterTheEnd(String),
    /// The plant cannot be started anew.
    #[error("plant.kill: a flight ends with its plant; plant.stop=20ms stops it for a while")]
    PlantKilled,
    /// A value for what takes none.
    #[error("{0} takes no value: write {0}@8s{end}", end = or_with_an_end(.0))]
    TakesNoValue(String),
    /// The value is out of what is allowed, or cannot be read.
    #[error("{what} = `{value}`: write {allowed}")]
    Value {
        what: String,
        value: String,
        allowed: String,
    },
    #[error("{name} = `{value}` is not a number")]
    NotANumber { name: String, value: String },
    /// A ramp whose length cannot be read.
    #[error(
        "{name}: a ramp of `{time}`: {why}; write the time that it takes, as in {name}={value}~2s or ~500ms"
    )]
    RampTime {
        name: String,
        value: String,
        time: String,
        why: String,
    },
    #[error(
        "`{0}` has no sign: write NAME=+30% for three tenths more than nominal, NAME=-30% for less"
    )]
    Unsigned(String),
    #[error("{0} is nominally 0, of which there is no share: write a number{unit}", unit = in_unit(*.0))]
    NothingToScale(Parameter),
    /// Two faults have a say in the same messages.
    #[error(
        "`{what}` is given twice for the same ticks at {port}: let one end before the other begins"
    )]
    Contradiction { what: &'static str, port: Port },
    #[error("{0} is given for these ticks already: let one end before the other begins")]
    Again(String),
    /// Two faults of a stage in the same ticks.
    #[error(
        "two faults of {role} meet: one from tick {first}, one from tick {second}: let one end before"
    )]
    StageMeets { role: Role, first: u64, second: u64 },
    #[error(
        "there are more than {MOST} faults of messages, counted by input, or more than {MOST_LIVE} of processes: leave some out"
    )]
    TooMany,
    /// The parameter is unknown or its value out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    #[error(transparent)]
    Swap(#[from] SwapError),
}

impl FaultError {
    /// Where what is allowed is listed; `flags` stand behind the command for parameters.
    #[must_use]
    pub fn listed(&self, flags: &str) -> String {
        match self {
            Self::Unknown { .. }
            | Self::NoInput { .. }
            | Self::Processor(_)
            | Self::NotLasting(_)
            | Self::NothingToEnd(_)
            | Self::AfterTheEnd(_)
            | Self::PlantKilled
            | Self::TakesNoValue(_)
            | Self::Value { .. }
            | Self::StageEnds(_)
            | Self::Again(_)
            | Self::StageMeets { .. }
            | Self::Contradiction { .. }
            | Self::NoInstant(_)
            | Self::SeveralInstants(_)
            | Self::Instant(_)
            | Self::Order { .. }
            | Self::TooMany => "`ironbird faults` lists what there is".into(),
            _ => format!("`ironbird params{flags}` lists names, units and ranges"),
        }
    }
}

fn inputs(role: Role) -> String {
    let inputs = messages::fault::PORTS
        .into_iter()
        .filter(|port| port.role() == role);
    let names: Vec<String> = inputs.map(|port| format!("`{}`", port.topic())).collect();
    format!("it receives {}", names.join(" and "))
}

/// How what takes no value is written with an end, where it has one.
fn or_with_an_end(what: &str) -> String {
    if what.ends_with(".kill") {
        String::new()
    } else {
        format!(" or {what}@8s..9s")
    }
}

/// A time as it is typed.
pub(crate) fn typed(time: Duration) -> String {
    humantime::format_duration(time)
        .to_string()
        .replace(' ', "")
}

/// A text, or the begin of a long one.
pub(super) fn begin_of(text: &str) -> String {
    const MOST: usize = 40;
    let begin: String = text.chars().take(MOST).collect();
    if begin.len() < text.len() {
        begin + "..."
    } else {
        begin
    }
}

/// A unit as it ends a hint.
fn in_unit(parameter: Parameter) -> String {
    match parameter.spec().unit {
        "" => String::new(),
        unit => format!(" in {unit}"),
    }
}
