//! A message of one of the topics of the flight log.

use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::{Header, Message};
use messages::monitor::Monitor;
use messages::telemetry::Telemetry;

use crate::TOPICS;

/// Messages per topic, in the order of [`TOPICS`].
pub type Counts = [u64; TOPICS.len()];

/// A message of one of the topics.
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
}

impl LogEntry {
    /// An empty message of a topic, by its place in [`TOPICS`].
    pub(crate) fn empty(topic: usize) -> Self {
        match topic {
            0 => Self::State(Message::default()),
            1 => Self::Setpoint(Message::default()),
            2 => Self::Wrench(Message::default()),
            3 => Self::RotorSpeeds(Message::default()),
            4 => Self::Swap(Message::default()),
            _ => Self::Theorem(Message::default()),
        }
    }

    pub const fn envelope(&self) -> &Header {
        match self {
            Self::State(message) => &message.envelope,
            Self::Setpoint(message) => &message.envelope,
            Self::Wrench(message) => &message.envelope,
            Self::RotorSpeeds(message) => &message.envelope,
            Self::Swap(message) => &message.envelope,
            Self::Theorem(message) => &message.envelope,
        }
    }

    /// What the law of its sender shows in it; none where the sender has no law.
    pub(crate) const fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        match self {
            Self::Setpoint(message) => Some(&mut message.content.telemetry),
            Self::Wrench(message) => Some(&mut message.content.telemetry),
            Self::RotorSpeeds(message) => Some(&mut message.content.telemetry),
            Self::State(_) | Self::Swap(_) | Self::Theorem(_) => None,
        }
    }

    /// Its topic's place in [`TOPICS`].
    pub const fn topic(&self) -> usize {
        match self {
            Self::State(_) => 0,
            Self::Setpoint(_) => 1,
            Self::Wrench(_) => 2,
            Self::RotorSpeeds(_) => 3,
            Self::Swap(_) => 4,
            Self::Theorem(_) => 5,
        }
    }
}
