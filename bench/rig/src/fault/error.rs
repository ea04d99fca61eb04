//! Why a fault was refused.

use model::fault::live::{MOST_LIVE, NOTICE_TICKS};
use model::fault::{MOST, Port};
use model::parameters::{Parameter, ParameterError};
use model::role::Role;
use plant::SwapError;
use thiserror::Error;

use crate::fault::in_unit;

/// Why a fault was refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FaultError {
    /// No instant.
    #[error("`{0}` has no time: write it behind, as in {0}@8s or {0}@tick8000")]
    NoInstant(String),
    /// Several instants.
    #[error("`{0}` has several instants: give --fault once for each")]
    SeveralInstants(String),
    /// The instant cannot be read.
    #[error("`{0}` is no instant: write @8s, @500ms or @tick8000, and ..9s behind it for an end")]
    Instant(String),
    /// It ends before it begins.
    #[error("`{fault}` ends at tick {to}, and begins at tick {from}: write the earlier one first, as in @8s..9s")]
    Order {
        /// The fault.
        fault: String,
        /// Tick of its begin.
        from: u64,
        /// Tick of its end.
        to: u64,
    },
    /// A parameter that would change back by itself.
    #[error("{0} holds until it is changed again: leave the end out, and plan the change back, as in {0}=nominal@9s")]
    ParameterEnds(Parameter),
    /// An end for what happens once.
    #[error("{0} happens once, at an instant: leave the end out")]
    StageEnds(String),
    /// No `=`.
    #[error("`{0}` is not an assignment: write NAME=VALUE, as in rotational_drag_nm_s=0.525")]
    NoAssignment(String),
    /// No fault has this name.
    #[error("unknown fault `{name}`{hint}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// What is amiss with it where that can be told, or the known name most like it.
        hint: String,
    },
    /// The stage has no such input.
    #[error("{role} does not receive `{topic}`: {}", inputs(*role))]
    NoInput {
        /// The stage.
        role: Role,
        /// The topic.
        topic: &'static str,
    },
    /// A fault of the processor, of a flight that needs none.
    #[error("{0}: ticks of a simulation need no processor: leave it out, or fly it with `ironbird fly`")]
    Processor(&'static str),
    /// What happens once does not end.
    #[error("{0} happens once: there is nothing to end")]
    NotLasting(String),
    /// Nothing strikes that could be ended.
    #[error("{0}=off: it does not strike then or later")]
    NothingToEnd(String),
    /// The flight is over before it.
    #[error("{0} never strikes: the flight ends before, and all stages are told {NOTICE_TICKS} ticks ahead")]
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
        /// The fault.
        what: String,
        /// What stands for its value.
        value: String,
        /// What is allowed.
        allowed: String,
    },
    /// The value is no number.
    #[error("{name} = `{value}` is not a number")]
    NotANumber {
        /// The parameter.
        name: String,
        /// What stands for its value.
        value: String,
    },
    /// A ramp whose length cannot be read.
    #[error("{name}: a ramp of `{time}`: {why}; write the time that it takes, as in {name}={value}~2s or ~500ms")]
    RampTime {
        /// The parameter.
        name: String,
        /// What stands for its value.
        value: String,
        /// What stands for the time.
        time: String,
        /// What is wrong with it.
        why: String,
    },
    /// A share without a sign.
    #[error("`{0}` has no sign: write NAME=+30% for three tenths more than nominal, NAME=-30% for less")]
    Unsigned(String),
    /// A share of nothing.
    #[error("{0} is nominally 0, of which there is no share: write a number{unit}", unit = in_unit(*.0))]
    NothingToScale(Parameter),
    /// Two faults have a say in the same messages.
    #[error("`{what}` is given twice for the same ticks at {port}: let one end before the other begins")]
    Contradiction {
        /// What is given twice.
        what: &'static str,
        /// At which input.
        port: Port,
    },
    /// The same is wrong already.
    #[error("{0} is given for these ticks already: let one end before the other begins")]
    Again(String),
    /// Two faults of a stage in the same ticks.
    #[error("two faults of {role} meet: one from tick {first}, one from tick {second}: let one end before")]
    StageMeets {
        /// The stage.
        role: Role,
        /// Where the first begins.
        first: u64,
        /// Where the second begins.
        second: u64,
    },
    /// The table is full.
    #[error(
        "there are more than {MOST} faults of messages, counted by input, or more than {MOST_LIVE} of processes: leave some out"
    )]
    TooMany,
    /// The parameter is unknown or its value out of range.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The plant would refuse it.
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

/// What a stage receives.
fn inputs(role: Role) -> String {
    let inputs = model::fault::PORTS.into_iter().filter(|port| port.role() == role);
    let names: Vec<String> = inputs.map(|port| format!("`{}`", port.topic())).collect();
    format!("it receives {}", names.join(" and "))
}

/// How what takes no value is written with an end, where it has one.
fn or_with_an_end(what: &str) -> String {
    if what.ends_with(".kill") { String::new() } else { format!(" or {what}@8s..9s") }
}
