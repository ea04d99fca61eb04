//! Kinds of message faults, the inputs and numbers that they change, and the ticks in which they act.

use std::fmt;

use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::fault_id::FaultId;
use messages::role::Role;
use messages::topic::Topic;

use crate::fields::{Faulty as _, Field};

/// The most ticks by which a message is delayed, or its content lags: the plant keeps at most 64 commands.
pub const LONGEST_DELAY_TICKS: u64 = 60;

/// Messages of the longest pattern of losses.
pub const LONGEST_PATTERN: u64 = 1_000_000;

/// An input of a stage, where message faults act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    OuterState,
    InnerState,
    InnerSetpoint,
    MixerWrench,
    PlantRotorSpeeds,
}

pub const PORTS: [Port; 5] = [
    Port::OuterState,
    Port::InnerState,
    Port::InnerSetpoint,
    Port::MixerWrench,
    Port::PlantRotorSpeeds,
];

impl Port {
    /// The input of a stage for a topic, if it has one that can have faults.
    pub fn of(role: Role, topic: &str) -> Option<Self> {
        PORTS
            .into_iter()
            .find(|port| port.role() == role && port.topic() == topic)
    }

    /// The stage that receives, its topic, and the fields of the topic that faults can act on.
    const fn spec(self) -> (Role, &'static str, &'static [Field]) {
        match self {
            Self::OuterState => (Role::Outer, State::NAME, State::FAULT_FIELDS),
            Self::InnerState => (Role::Inner, State::NAME, State::FAULT_FIELDS),
            Self::InnerSetpoint => (Role::Inner, Setpoint::NAME, Setpoint::FAULT_FIELDS),
            Self::MixerWrench => (Role::Mixer, Wrench::NAME, Wrench::FAULT_FIELDS),
            Self::PlantRotorSpeeds => (Role::Plant, RotorSpeeds::NAME, RotorSpeeds::FAULT_FIELDS),
        }
    }

    pub const fn role(self) -> Role {
        self.spec().0
    }

    /// Name of the topic that it receives.
    pub const fn topic(self) -> &'static str {
        self.spec().1
    }

    /// Fields of the topic that faults can act on.
    pub const fn fields(self) -> &'static [Field] {
        self.spec().2
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.role(), self.topic())
    }
}

/// A field of a message, or one number of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Place of the field among those that faults can change.
    pub field: usize,
    /// Place of the number in it; none is all of them.
    pub axis: Option<usize>,
}

impl Place {
    pub fn overlaps(self, other: Self) -> bool {
        let same_axis = self.axis.zip(other.axis).is_none_or(|(a, b)| a == b);
        self.field == other.field && same_axis
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A random share of the messages, 0 to 1, is lost.
    Drop(f64),
    /// The first `lost` of every `of` messages are lost.
    DropEach {
        lost: u64,
        of: u64,
    },
    Delay(u64),
    /// Messages arrive on time with the content of this many ticks earlier.
    Lag(u64),
    /// Messages arrive on time with the last content before the fault.
    Freeze,
    /// A number has normal noise of this standard deviation, in the field's unit.
    Noise(Place, f64),
    /// A constant is added to a number, in the field's unit.
    Bias(Place, f64),
    Nan(Place),
}

impl Kind {
    pub(crate) const fn id(self) -> FaultId {
        match self {
            Self::Drop(_) => FaultId::Drop,
            Self::DropEach { .. } => FaultId::DropEach,
            Self::Delay(_) => FaultId::Delay,
            Self::Lag(_) => FaultId::Lag,
            Self::Freeze => FaultId::Freeze,
            Self::Noise(..) => FaultId::Noise,
            Self::Bias(..) => FaultId::Bias,
            Self::Nan(_) => FaultId::Nan,
        }
    }

    /// Its two numbers, or the bits of them.
    pub(crate) const fn numbers(self) -> [u64; 2] {
        match self {
            Self::Drop(number) | Self::Noise(_, number) | Self::Bias(_, number) => {
                [number.to_bits(), 0]
            }
            Self::DropEach { lost, of } => [lost, of],
            Self::Delay(ticks) | Self::Lag(ticks) => [ticks, 0],
            Self::Freeze | Self::Nan(_) => [0, 0],
        }
    }

    /// Whether its numbers are in range.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Drop(share) => is_share(share),
            Self::DropEach { lost, of } => 1 <= lost && lost <= of && of <= LONGEST_PATTERN,
            Self::Delay(ticks) | Self::Lag(ticks) => (1..=LONGEST_DELAY_TICKS).contains(&ticks),
            Self::Noise(_, deviation) => deviation.is_finite() && deviation > 0.0,
            Self::Bias(_, more) => more.is_finite() && more != 0.0,
            Self::Freeze | Self::Nan(_) => true,
        }
    }

    /// The number that it changes, if it does not act on the whole message.
    pub const fn place(self) -> Option<Place> {
        match self {
            Self::Noise(place, _) | Self::Bias(place, _) | Self::Nan(place) => Some(place),
            _ => None,
        }
    }
}

/// Whether a number is a share of something, and not of nothing.
pub fn is_share(number: f64) -> bool {
    number > 0.0 && number <= 1.0
}

/// Ticks from the first to the one before `to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    pub from: u64,
    /// The first one after it; [`Span::FOR_GOOD`] where it has no end.
    pub to: u64,
}

impl Span {
    pub const FOR_GOOD: u64 = u64::MAX;

    pub const fn new(from: u64, to: u64) -> Self {
        Self { from, to }
    }

    /// The first tick alone.
    pub fn once(self) -> Self {
        self.cut(self.from.saturating_add(1))
    }

    pub const fn contains(self, tick: u64) -> bool {
        self.from <= tick && tick < self.to
    }

    pub fn overlaps(self, other: Self) -> bool {
        self.from.max(other.from) < self.to.min(other.to)
    }

    /// The same up to a tick; none of it is left where it begins then.
    pub fn cut(self, tick: u64) -> Self {
        Self {
            to: self.to.min(self.from.max(tick)),
            ..self
        }
    }
}
