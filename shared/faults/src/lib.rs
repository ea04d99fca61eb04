//! Faults: their kinds, the filters that apply them to messages, and the text in which users write them.
//!
//! A message fault acts behind the inspection of an input ([`gate`]), and depends on the tick of the message alone. It is
//! therefore the same in processes, in one process and in replay, at any pace. Faults of parameters are changes that the
//! plant applies ([`swap`]); those of processes are done by the supervisor.
//!
//! Start with [`code::FAULTS`], the table of all kinds. [`grammar`] reads and prints faults, [`plan`] gives them ticks.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod code;
pub mod fields;
pub mod gate;
pub mod grammar;
pub mod live;
pub mod plan;
pub mod swap;

use std::fmt;

use messages::fault_id::FaultId;

use code::FaultSpec;
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

/// An input of a stage: where faults of messages strike.
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
            Self::OuterState => (Role::Outer, State::NAME, State::STRUCK),
            Self::InnerState => (Role::Inner, State::NAME, State::STRUCK),
            Self::InnerSetpoint => (Role::Inner, Setpoint::NAME, Setpoint::STRUCK),
            Self::MixerWrench => (Role::Mixer, Wrench::NAME, Wrench::STRUCK),
            Self::PlantRotorSpeeds => (Role::Plant, RotorSpeeds::NAME, RotorSpeeds::STRUCK),
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
    /// Place of the field among those that faults can strike.
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
    /// The first so many of each so many are lost.
    DropEach {
        lost: u64,
        of: u64,
    },
    Delay(u64),
    /// They come in time, and with the content of so many ticks before.
    Lag(u64),
    /// They come in time, and with the content of the last one before the fault.
    Freeze,
    /// A number has normal noise of this standard deviation, in the field's unit.
    Noise(Place, f64),
    /// A number is so much larger, in the field's unit.
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

    /// The number that it strikes, where it is not the whole message.
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

/// A fault of the messages at an input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageFault {
    pub port: Port,
    pub kind: Kind,
    pub span: Span,
}

impl Spanned for MessageFault {
    fn span(&self) -> Span {
        self.span
    }

    fn span_mut(&mut self) -> &mut Span {
        &mut self.span
    }

    fn contradicts(&self, other: &Self) -> bool {
        self.port == other.port && self.kind.is_like(other.kind) && self.span.meets(other.span)
    }
}

/// Faults of one sort in a flight, and the seed of what is random in them.
///
/// The place of a fault is its number: what it draws depends on seed, number and tick alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultList<F> {
    pub seed: u64,
    faults: [Option<F>; MOST],
}

pub type MessageFaults = FaultList<MessageFault>;

/// A fault that acts in a span of ticks.
pub trait Spanned: Copy {
    fn span(&self) -> Span;

    fn span_mut(&mut self) -> &mut Span;

    /// Whether both would have a say in the same message or stage, and contradict each other.
    fn contradicts(&self, other: &Self) -> bool;
}

impl<F: Spanned> FaultList<F> {
    pub const fn none(seed: u64) -> Self {
        Self {
            seed,
            faults: [None; MOST],
        }
    }

    pub fn push(&mut self, fault: F) -> Result<(), FaultRefusal> {
        if self.iter().any(|(_, other)| other.contradicts(&fault)) {
            return Err(FaultRefusal::Contradiction);
        }
        let mut places = self.faults.iter_mut();
        *places
            .find(|place| place.is_none())
            .ok_or(FaultRefusal::NoRoom)? = Some(fault);
        Ok(())
    }

    /// Ends those that are meant, from a tick on.
    pub(crate) fn end_where(
        &mut self,
        tick: u64,
        is_meant: impl Fn(&F) -> bool,
    ) -> Result<(), FaultRefusal> {
        let faults = self.faults.iter_mut().flatten();
        let mut meant = faults
            .filter(|fault| is_meant(fault) && fault.span().to > tick)
            .peekable();
        meant.peek().ok_or(FaultRefusal::NothingToEnd)?;
        meant.for_each(|fault| *fault.span_mut() = fault.span().cut(tick));
        Ok(())
    }

    /// Those that are meant, under their numbers.
    pub(crate) fn only(&self, is_meant: impl Fn(&F) -> bool) -> Self {
        Self {
            faults: self.faults.map(|fault| fault.filter(&is_meant)),
            ..*self
        }
    }

    /// All of them, each with its number.
    pub fn iter(&self) -> impl Iterator<Item = (u64, &F)> {
        (0..)
            .zip(&self.faults)
            .filter_map(|(number, fault)| Some((number, fault.as_ref()?)))
    }

    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }
}

impl MessageFaults {
    /// Ends those that do at an input what `kind` does, from a tick on. Whatever number the kind has is not looked at.
    pub fn end(&mut self, port: Port, kind: Kind, tick: u64) -> Result<(), FaultRefusal> {
        self.end_where(tick, |fault| fault.port == port && fault.kind.is_like(kind))
    }

    pub fn of(&self, port: Port) -> impl Iterator<Item = (u64, &MessageFault)> {
        self.iter().filter(move |(_, fault)| fault.port == port)
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

    use Port::{InnerState, OuterState};

    fn fault(port: Port, kind: Kind, from: u64, to: u64) -> MessageFault {
        let span = Span { from, to };
        MessageFault { port, kind, span }
    }

    const fn place(axis: Option<usize>) -> Place {
        Place { field: 0, axis }
    }

    #[test]
    fn faults_contradict_each_other_in_the_same_messages_and_numbers_alone() {
        let drop = fault(OuterState, Kind::Drop(0.1), 10, 20);
        let bias = fault(OuterState, Kind::Bias(place(Some(1)), 1.0), 10, 20);
        let pattern = Kind::DropEach { lost: 1, of: 2 };
        for (fault, port, kind, from, expected) in [
            (drop, OuterState, pattern, 19, true),
            (drop, OuterState, Kind::Drop(0.2), 20, false),
            (drop, InnerState, Kind::Drop(0.2), 10, false),
            (drop, OuterState, Kind::Delay(3), 10, false),
            (bias, OuterState, Kind::Bias(place(None), 1.0), 10, true),
            (bias, OuterState, Kind::Bias(place(Some(2)), 1.0), 10, false),
            (
                bias,
                OuterState,
                Kind::Noise(place(Some(1)), 1.0),
                10,
                false,
            ),
        ] {
            let other = self::fault(port, kind, from, 30);
            assert_eq!(fault.contradicts(&other), expected, "{other:?}");
        }
    }

    #[test]
    fn a_fault_is_ended_by_its_name_whatever_its_number() {
        let mut faults = MessageFaults::none(7);
        let drop = |port| fault(port, Kind::Drop(0.1), 10, Span::FOR_GOOD);
        faults.push(drop(OuterState)).unwrap();
        faults.push(drop(InnerState)).unwrap();
        let pattern = Kind::DropEach { lost: 1, of: 2 };
        for (port, kind, tick, ended) in [
            (
                OuterState,
                Kind::Delay(1),
                20,
                Err(FaultRefusal::NothingToEnd),
            ),
            (OuterState, Kind::Drop(1.0), 20, Ok(())),
            (
                OuterState,
                Kind::Drop(1.0),
                20,
                Err(FaultRefusal::NothingToEnd),
            ),
            (InnerState, pattern, 5, Ok(())),
        ] {
            assert_eq!(faults.end(port, kind, tick), ended, "{kind:?}");
        }
        let spans: Vec<Span> = faults.iter().map(|(_, fault)| fault.span).collect();
        // What was ended before its begin never strikes, and contradicts nothing.
        assert_eq!(
            spans,
            [(10, 20), (10, 10)].map(|(from, to)| Span { from, to })
        );
        assert_eq!(faults.push(drop(InnerState)), Ok(()));
        assert_eq!(
            faults.push(drop(InnerState)),
            Err(FaultRefusal::Contradiction)
        );
    }

    #[test]
    fn a_table_that_is_full_takes_no_more() {
        let mut faults = MessageFaults::none(7);
        assert!(faults.is_empty());
        let one = |number: u64| fault(Port::MixerWrench, Kind::Freeze, number, number + 1);
        (0..MOST as u64).for_each(|number| faults.push(one(number)).unwrap());
        assert_eq!(faults.push(one(MOST as u64)), Err(FaultRefusal::NoRoom));
        let numbers = faults.of(Port::MixerWrench).map(|(number, _)| number);
        assert!(numbers.eq(0..MOST as u64));
        assert_eq!(faults.of(OuterState).count(), 0);
    }
}
