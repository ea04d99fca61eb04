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
mod kind;
pub mod live;
pub mod plan;
pub mod swap;

use code::{FaultKind, LiveFault};
use messages::role::Role;

pub use kind::*;
pub use messages::fault_id::FaultRefusal;

/// Faults of messages that one flight can have, counted by input: `state.drop` makes two of them.
pub const MAX_MESSAGE_FAULTS: usize = 32;

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
    faults: [Option<LiveFault>; MAX_MESSAGE_FAULTS],
}

pub type MessageFaults = FaultList;

impl FaultList {
    pub const fn none(seed: u64) -> Self {
        Self {
            seed,
            faults: [None; MAX_MESSAGE_FAULTS],
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
        if like.any(|other| other.kind.is_like(&kind) && other.span.overlaps(span)) {
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
        (0..MAX_MESSAGE_FAULTS as u64).for_each(|number| faults.take(&one(number)).unwrap());
        assert_eq!(faults.take(&one(MAX_MESSAGE_FAULTS as u64)), Err(NoRoom));
        let numbers = faults.of(Port::MixerWrench).map(|(number, _)| number);
        assert!(numbers.eq(0..MAX_MESSAGE_FAULTS as u64));
        assert_eq!(faults.of(OuterState).count(), 0);
    }
}
