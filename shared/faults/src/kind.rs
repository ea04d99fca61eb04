//! A fault: its kind, the input, number or stage that it acts on, and the ticks in which it acts.

use std::fmt;

use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
pub use messages::fault_kinds::*;
use messages::fields::{Faulty as _, Field};
use messages::role::{Channel, Replica, Role};
use messages::topic::Topic;

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

/// A kind of fault, and what it acts on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    Message(MessageKind, Port),
    Number(NumberKind, Port, Place),
    /// A stage in one channel, or in all if none is named.
    Stage(StageKind, Role, Option<Channel>),
    Processor(ProcessorKind),
    Channel(ChannelKind, Channel),
}

/// Kind and place of a fault, and its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultKind {
    pub target: Target,
    pub value: FaultValue,
}

impl FaultKind {
    pub const fn spec(&self) -> &'static FaultSpec {
        let kind = match self.target {
            Target::Message(kind, _) => Kind::Message(kind),
            Target::Number(kind, ..) => Kind::Number(kind),
            Target::Stage(kind, ..) => Kind::Stage(kind),
            Target::Processor(kind) => Kind::Processor(kind),
            Target::Channel(kind, _) => Kind::Channel(kind),
        };
        kind.spec()
    }

    /// The input whose messages it changes.
    pub const fn port(&self) -> Option<Port> {
        match self.target {
            Target::Message(_, port) | Target::Number(_, port, _) => Some(port),
            Target::Stage(..) | Target::Processor(_) | Target::Channel(..) => None,
        }
    }

    /// This fault at another input.
    pub(crate) const fn at(mut self, other: Port) -> Self {
        if let Target::Message(_, port) | Target::Number(_, port, _) = &mut self.target {
            *port = other;
        }
        self
    }

    /// The stage that it acts on, where it acts on the process of one.
    pub const fn role(&self) -> Option<Role> {
        match self.target {
            Target::Stage(_, role, _) => Some(role),
            Target::Message(..)
            | Target::Number(..)
            | Target::Processor(_)
            | Target::Channel(..) => None,
        }
    }

    /// The channel that it acts on, if it is one alone.
    pub const fn channel(&self) -> Option<Channel> {
        match self.target {
            Target::Stage(_, _, channel) => channel,
            Target::Channel(_, channel) => Some(channel),
            Target::Message(..) | Target::Number(..) | Target::Processor(_) => None,
        }
    }

    /// The channel whose laws fly from its tick on.
    pub const fn switch(&self) -> Option<Channel> {
        match self.target {
            Target::Channel(ChannelKind::Switch, channel) => Some(channel),
            Target::Message(..) | Target::Number(..) | Target::Stage(..) | Target::Processor(_) => {
                None
            }
        }
    }

    /// The ticks of its stage.
    pub const fn stage_ticks(&self) -> Option<StageTicks> {
        match self.target {
            Target::Stage(kind, ..) => Some(kind.ticks(self.value)),
            Target::Message(..)
            | Target::Number(..)
            | Target::Processor(_)
            | Target::Channel(..) => None,
        }
    }

    /// Whether the fault acts on the process of this stage.
    pub fn is_of(&self, replica: Replica) -> bool {
        self.role() == Some(replica.role) && self.channel().is_none_or(|it| it == replica.channel)
    }

    /// Whether both act on the process of one stage.
    pub fn overlaps(&self, other: &Self) -> bool {
        let channels = self.channel().zip(other.channel());
        self.role() == other.role() && channels.is_none_or(|(one, other)| one == other)
    }

    /// Whether the end of a fault ends this one: of the same kind and place. That of all axes ends the fault of one, and
    /// that of a stage in all channels ends the fault in one channel.
    pub fn is_ended_by(&self, end: &Self) -> bool {
        let contains = match (end.target, self.target) {
            (Target::Number(.., whole), Target::Number(.., part)) => {
                whole.axis.is_none() || whole.axis == part.axis
            }
            (Target::Stage(.., whole), Target::Stage(.., part)) => whole.is_none() || whole == part,
            _ => true,
        };
        contains && self.is_like(end)
    }

    /// Whether kind and place are the same or overlap, whatever the values are.
    pub fn is_like(&self, other: &Self) -> bool {
        match (self.target, other.target) {
            (Target::Message(_, one), Target::Message(_, other_port)) => {
                one == other_port && self.spec().name == other.spec().name
            }
            (Target::Number(kind, port, place), Target::Number(other_kind, at, other_place)) => {
                (kind, port) == (other_kind, at) && place.overlaps(other_place)
            }
            (Target::Stage(kind, ..), Target::Stage(other_kind, ..)) => {
                kind == other_kind && self.overlaps(other)
            }
            (one, other) => one == other,
        }
    }
}

/// A fault with its ticks, or the end of what it names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFault {
    pub kind: FaultKind,
    /// Whether it ends with the first tick of the span; its value means nothing then.
    pub ends: bool,
    pub span: Span,
}

impl LiveFault {
    /// The ticks in which it acts, of those requested: what happens once happens in the first one.
    pub fn span_from(&self, requested: Span) -> Span {
        let is_once = match self.kind.spec().lasts {
            Lasts::ForGood => false,
            Lasts::OneTick => requested.to == Span::FOR_GOOD,
            Lasts::Instant => true,
        };
        if self.ends || is_once {
            requested.once()
        } else {
            requested
        }
    }
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
