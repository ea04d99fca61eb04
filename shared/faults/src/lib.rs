//! Faults: their kinds, the filters that apply them to messages, and the text in which users write them.
//!
//! A message fault acts behind the inspection of an input ([`filter`]), and depends on the tick of the message alone. It is
//! therefore the same in processes, in one process and in replay, at any pace. Faults of parameters are changes that the
//! plant applies ([`swap`]); those of processes are done by the supervisor.
//!
//! Start with [`code::FAULTS`], the table of all kinds. [`grammar`] reads and prints faults, [`plan`] gives them ticks.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod code;
pub mod fields;
pub mod filter;
pub mod grammar;
pub mod live;
pub mod plan;
pub mod swap;

use std::fmt;

use messages::fault_id::FaultId;

use code::{FaultKind, FaultSpec, LiveFault};
use fields::{Faulty as _, Field};
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
pub use messages::fault_id::FaultRefusal;
use messages::role::Role;
use messages::topic::Topic;

/// Faults of messages that one flight can have, counted by input: `state.drop` makes two of them.
pub const MOST: usize = 32;

/// The most ticks by which a message is delayed, or its content lags: the commands that can wait at the plant are 64.
pub const LONGEST_DELAY: u64 = 60;

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

/// A field of a message, or one number of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Place of the field among those that faults can change.
    pub field: usize,
    /// Place of the number in it; none is all of them.
    pub axis: Option<usize>,
}

impl Place {
    pub fn meets(self, other: Self) -> bool {
        let same_axis = self.axis.zip(other.axis).is_none_or(|(a, b)| a == b);
        self.field == other.field && same_axis
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A share of them, 0 to 1, is lost at random.
    Drop(f64),
    /// The first `lost` of every `of` messages are lost.
    DropEach {
        lost: u64,
        of: u64,
    },
    Delay(u64),
    /// They arrive on time with the content of this many ticks earlier.
    Lag(u64),
    /// They arrive on time with the last content before the fault.
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

    pub fn name(self) -> &'static str {
        FaultSpec::of(self.id() as u64).map_or("", |spec| spec.name)
    }

    /// Whether its numbers are ones that a fault may have.
    pub fn is_possible(self) -> bool {
        match self {
            Self::Drop(share) => is_share(share),
            Self::DropEach { lost, of } => 1 <= lost && lost <= of && of <= LONGEST_PATTERN,
            Self::Delay(ticks) | Self::Lag(ticks) => (1..=LONGEST_DELAY).contains(&ticks),
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

    /// Whether it does what another kind does, to the whole message or to a number that both mean.
    pub fn is_like(self, other: Self) -> bool {
        let same_place = match (self.place(), other.place()) {
            (Some(a), Some(b)) => a.meets(b),
            (a, b) => a.is_none() && b.is_none(),
        };
        self.name() == other.name() && same_place
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

    pub const fn holds(self, tick: u64) -> bool {
        self.from <= tick && tick < self.to
    }

    pub fn meets(self, other: Self) -> bool {
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

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageFault {
    pub port: Port,
    pub kind: Kind,
    pub span: Span,
}

impl From<MessageFault> for LiveFault {
    fn from(MessageFault { port, kind, span }: MessageFault) -> Self {
        Self {
            kind: FaultKind::Messages { port, kind },
            ends: false,
            span,
        }
    }
}

/// Faults of one sort in a flight, of messages or of late stages, and the seed of what is random in them.
///
/// The place of a fault is its number: what it draws depends on seed, number and tick alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultList {
    pub seed: u64,
    faults: [Option<LiveFault>; MOST],
}

pub type MessageFaults = FaultList;

impl FaultList {
    pub const fn none(seed: u64) -> Self {
        Self {
            seed,
            faults: [None; MOST],
        }
    }

    /// Adds a fault, or ends those like it from its first tick on; the numbers of an end mean nothing.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), FaultRefusal> {
        let LiveFault { kind, ends, span } = *fault;
        let mut like = self.faults.iter_mut().flatten();
        if ends {
            let mut ended = like
                .filter(|other| other.kind.is_like(&kind) && other.span.to > span.from)
                .peekable();
            ended.peek().ok_or(FaultRefusal::NothingToEnd)?;
            ended.for_each(|other| other.span = other.span.cut(span.from));
            return Ok(());
        }
        if like.any(|other| other.kind.is_like(&kind) && other.span.meets(span)) {
            return Err(FaultRefusal::Contradiction);
        }
        let place = self.faults.iter_mut().find(|place| place.is_none());
        *place.ok_or(FaultRefusal::NoRoom)? = Some(*fault);
        Ok(())
    }

    /// The faults of a stage, under their numbers.
    pub fn of_role(&self, role: Role) -> Self {
        let is_of = |fault: &LiveFault| fault.kind.role() == Some(role);
        Self {
            faults: self.faults.map(|fault| fault.filter(is_of)),
            ..*self
        }
    }

    /// All of them, each with its number.
    pub fn iter(&self) -> impl Iterator<Item = (u64, &LiveFault)> {
        (0..)
            .zip(&self.faults)
            .filter_map(|(number, fault)| Some((number, fault.as_ref()?)))
    }

    /// The faults of the messages at an input, each with its number.
    pub fn of(&self, input: Port) -> impl Iterator<Item = (u64, MessageFault)> {
        self.iter()
            .filter_map(move |(number, fault)| match fault.kind {
                FaultKind::Messages { port, kind } if port == input => {
                    let span = fault.span;
                    Some((number, MessageFault { port, kind, span }))
                }
                _ => None,
            })
    }

    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.role(), self.topic())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use FaultRefusal::{Contradiction, NoRoom, NothingToEnd};
    use Port::{InnerState, OuterState};

    fn fault(port: Port, kind: Kind, from: u64, to: u64) -> LiveFault {
        let span = Span { from, to };
        MessageFault { port, kind, span }.into()
    }

    const fn place(axis: Option<usize>) -> Place {
        Place { field: 0, axis }
    }

    #[test]
    fn faults_contradict_each_other_in_the_same_messages_and_numbers_alone() {
        let bias = |axis| Kind::Bias(place(axis), 1.0);
        let noise = Kind::Noise(place(Some(1)), 1.0);
        let pattern = Kind::DropEach { lost: 1, of: 2 };
        for (first, port, kind, from, expected) in [
            (Kind::Drop(0.1), OuterState, pattern, 19, Err(Contradiction)),
            (Kind::Drop(0.1), OuterState, Kind::Drop(0.2), 20, Ok(())),
            (Kind::Drop(0.1), InnerState, Kind::Drop(0.2), 10, Ok(())),
            (Kind::Drop(0.1), OuterState, Kind::Delay(3), 10, Ok(())),
            (
                bias(Some(1)),
                OuterState,
                bias(None),
                10,
                Err(Contradiction),
            ),
            (bias(Some(1)), OuterState, bias(Some(2)), 10, Ok(())),
            (bias(Some(1)), OuterState, noise, 10, Ok(())),
        ] {
            let mut faults = MessageFaults::none(7);
            faults.take(&fault(OuterState, first, 10, 20)).unwrap();
            let taken = faults.take(&fault(port, kind, from, 30));
            assert_eq!(taken, expected, "{kind:?}");
        }
    }

    #[test]
    fn a_fault_is_ended_by_its_name_whatever_its_number() {
        let mut faults = MessageFaults::none(7);
        let drop = |port| fault(port, Kind::Drop(0.1), 10, Span::FOR_GOOD);
        faults.take(&drop(OuterState)).unwrap();
        faults.take(&drop(InnerState)).unwrap();
        let pattern = Kind::DropEach { lost: 1, of: 2 };
        for (port, kind, tick, ended) in [
            (OuterState, Kind::Delay(1), 20, Err(NothingToEnd)),
            (OuterState, Kind::Drop(1.0), 20, Ok(())),
            (OuterState, Kind::Drop(1.0), 20, Err(NothingToEnd)),
            (InnerState, pattern, 5, Ok(())),
        ] {
            let end = LiveFault {
                ends: true,
                ..fault(port, kind, tick, tick + 1)
            };
            assert_eq!(faults.take(&end), ended, "{kind:?}");
        }
        let spans: Vec<Span> = faults.iter().map(|(_, fault)| fault.span).collect();
        // A fault that was ended before it began never acts, and contradicts nothing.
        assert_eq!(spans, [Span::new(10, 20), Span::new(10, 10)]);
        assert_eq!(faults.take(&drop(InnerState)), Ok(()));
        assert_eq!(faults.take(&drop(InnerState)), Err(Contradiction));
    }

    #[test]
    fn a_table_that_is_full_takes_no_more() {
        let mut faults = MessageFaults::none(7);
        assert!(faults.is_empty());
        let one = |number: u64| fault(Port::MixerWrench, Kind::Freeze, number, number + 1);
        (0..MOST as u64).for_each(|number| faults.take(&one(number)).unwrap());
        assert_eq!(faults.take(&one(MOST as u64)), Err(NoRoom));
        let numbers = faults.of(Port::MixerWrench).map(|(number, _)| number);
        assert!(numbers.eq(0..MOST as u64));
        assert_eq!(faults.of(OuterState).count(), 0);
    }
}
