//! A message of one of the topics of the flight log, and what is known of each topic before its first message.

use std::collections::BTreeMap;

use messages::content::{Decisions, Loss, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::monitor::Monitor;
use messages::role::Role;
use messages::telemetry::Telemetry;

use crate::codec::Logged;
use crate::{rows, schema, units};

pub type Counts = [u64; TOPICS.len()];

#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "the largest is the most frequent"
)]
pub enum LogEntry {
    State(Message<State>),
    Setpoint(Message<Setpoint>),
    Wrench(Message<Wrench>),
    RotorSpeeds(Message<RotorSpeeds>),
    Swap(Message<SwapRecord>),
    Theorem(Message<Monitor>),
    Decisions(Message<Decisions>),
    Loss(Message<Loss>),
}

/// The same for a message of any topic: `with_message!(entry, message => message.envelope.tick)`.
#[macro_export]
macro_rules! with_message {
    ($entry:expr, $message:ident => $same:expr) => {
        match $entry {
            $crate::entry::LogEntry::State($message) => $same,
            $crate::entry::LogEntry::Setpoint($message) => $same,
            $crate::entry::LogEntry::Wrench($message) => $same,
            $crate::entry::LogEntry::RotorSpeeds($message) => $same,
            $crate::entry::LogEntry::Swap($message) => $same,
            $crate::entry::LogEntry::Theorem($message) => $same,
            $crate::entry::LogEntry::Decisions($message) => $same,
            $crate::entry::LogEntry::Loss($message) => $same,
        }
    };
}
pub use with_message;

/// What is known of a topic before its first message.
pub struct TopicFormat {
    pub name: &'static str,
    pub sender: Role,
    pub schema_name: fn() -> String,
    pub descriptor_set: fn() -> Vec<u8>,
    pub describe: fn() -> BTreeMap<String, String>,
    pub columns: fn() -> Vec<rows::Column>,
    pub empty: fn() -> LogEntry,
}

impl TopicFormat {
    const fn of<C: Logged>(empty: fn() -> LogEntry) -> Self {
        Self {
            name: C::NAME,
            sender: C::SENDER,
            schema_name: schema::name::<C>,
            descriptor_set: schema::descriptor_set::<C>,
            describe: units::describe::<C>,
            columns: rows::columns::<C>,
            empty,
        }
    }
}

pub const FORMATS: [TopicFormat; 8] = [
    TopicFormat::of::<State>(|| LogEntry::State(Message::default())),
    TopicFormat::of::<Setpoint>(|| LogEntry::Setpoint(Message::default())),
    TopicFormat::of::<Wrench>(|| LogEntry::Wrench(Message::default())),
    TopicFormat::of::<RotorSpeeds>(|| LogEntry::RotorSpeeds(Message::default())),
    TopicFormat::of::<SwapRecord>(|| LogEntry::Swap(Message::default())),
    TopicFormat::of::<Monitor>(|| LogEntry::Theorem(Message::default())),
    TopicFormat::of::<Decisions>(|| LogEntry::Decisions(Message::default())),
    TopicFormat::of::<Loss>(|| LogEntry::Loss(Message::default())),
];

/// Topics of the loop, in the order of data flow, then the others.
pub const TOPICS: [&str; FORMATS.len()] = {
    let [a, b, c, d, e, f, g, h] = &FORMATS;
    [
        a.name, b.name, c.name, d.name, e.name, f.name, g.name, h.name,
    ]
};

impl LogEntry {
    pub const fn envelope(&self) -> &Header {
        with_message!(self, message => &message.envelope)
    }

    /// The signals of its sender's law; none where the sender has no law.
    pub const fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        match self {
            Self::Setpoint(message) => Some(&mut message.content.telemetry),
            Self::Wrench(message) => Some(&mut message.content.telemetry),
            Self::RotorSpeeds(message) => Some(&mut message.content.telemetry),
            _ => None,
        }
    }

    pub const fn topic(&self) -> usize {
        match self {
            Self::State(_) => 0,
            Self::Setpoint(_) => 1,
            Self::Wrench(_) => 2,
            Self::RotorSpeeds(_) => 3,
            Self::Swap(_) => 4,
            Self::Theorem(_) => 5,
            Self::Decisions(_) => 6,
            Self::Loss(_) => 7,
        }
    }
}
