//! Faults that are injected into a flight in the air: what they are in words of the wire, and when they take hold.
//!
//! The plant puts them on the board [`LIVE`] before it publishes the state of the tick in which it took them in. A stage
//! that has heard of that tick has them too. They take hold [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the same fault is the same flight as if it had been
//! planned.

use crate::fault::late::{Late, LateStages};
use crate::fault::{Kind, LONGEST_DELAY, MessageFault, MessageFaults, NotTaken, PORTS, Place, Port, Span};
use crate::layout::{from_wire, layout};
use crate::role::{Role, STAGES};

/// Name of the plant's board with the [`LiveBoard`].
pub const LIVE: &str = "faults";

/// Faults that can be injected into one flight, each counted as often as it has inputs; an end counts as one, too.
pub const MOST_LIVE: usize = 64;

/// Ticks from the plant's taking in a fault to the first one that it strikes, at the least.
pub const NOTICE_TICKS: u64 = LONGEST_DELAY + 4;

/// What goes wrong in the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The messages at an input.
    Messages {
        /// Which input.
        port: Port,
        /// What is wrong with them.
        kind: Kind,
    },
    /// A stage computes longer.
    Late {
        /// Which stage.
        role: Role,
        /// The least [ns].
        least_ns: u64,
        /// The most [ns].
        most_ns: u64,
    },
    /// The process of a stage is stopped, and goes on.
    Stop {
        /// Which stage.
        role: Role,
        /// For how long [ns].
        for_ns: u64,
    },
    /// The process of a stage is killed.
    Kill {
        /// Which stage.
        role: Role,
    },
    /// A process is always busy on the loops' processor, under SCHED_FIFO.
    Hog {
        /// At this priority.
        priority: u64,
    },
    /// A process of ordinary priority is busy on the loops' processor.
    Load {
        /// In this share of its time.
        share: f64,
    },
}

impl Trouble {
    /// Whether it is the same thing that goes wrong, whatever the numbers are.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        match (*self, *other) {
            (Self::Messages { port, kind }, Self::Messages { port: other, kind: with }) => {
                MessageFault { port, kind, span: Span { from: 0, to: 1 } }.is_like(other, with)
            }
            (Self::Late { role, .. }, Self::Late { role: other, .. })
            | (Self::Stop { role, .. }, Self::Stop { role: other, .. })
            | (Self::Kill { role }, Self::Kill { role: other }) => role == other,
            (Self::Hog { .. }, Self::Hog { .. }) | (Self::Load { .. }, Self::Load { .. }) => true,
            _ => false,
        }
    }
}

/// A fault with its ticks, or the end of what it names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiveFault {
    /// What goes wrong.
    pub trouble: Trouble,
    /// Whether it ends with the first tick of the span; its numbers mean nothing then.
    pub ends: bool,
    /// In which ticks.
    pub span: Span,
}

impl LiveFault {
    /// The ticks that it strikes of those that were asked for: what happens once happens in the first one.
    #[must_use]
    pub const fn span_from(&self, asked: Span) -> Span {
        match self.trouble {
            Trouble::Stop { .. } | Trouble::Kill { .. } => asked.cut(asked.from.saturating_add(1)),
            _ if self.ends => asked.cut(asked.from.saturating_add(1)),
            Trouble::Late { .. } if asked.to == Span::FOR_GOOD => asked.cut(asked.from.saturating_add(1)),
            _ => asked,
        }
    }
}

/// What goes wrong, as a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
enum What {
    Drop = 1,
    DropEach = 2,
    Delay = 3,
    Lag = 4,
    Freeze = 5,
    Noise = 6,
    Bias = 7,
    Nan = 8,
    Late = 9,
    Stop = 10,
    Kill = 11,
    Hog = 12,
    Load = 13,
}
from_wire!(What { Drop, DropEach, Delay, Lag, Freeze, Noise, Bias, Nan, Late, Stop, Kill, Hog, Load });

/// Hash over the words of faults and their numbers.
pub const WORDS: u64 = What::WORDS;

/// The same as numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct FaultWords {
    /// What goes wrong.
    pub what: u64,
    /// Place of the input among [`PORTS`], or of the stage among [`STAGES`].
    pub place: u64,
    /// Place of the field among those that faults can strike.
    pub field: u64,
    /// Place of the number in it, and 1; 0 is all of them.
    pub axis: u64,
    /// The number of the fault, or the bits of it.
    pub first: u64,
    /// A second one.
    pub second: u64,
    /// Whether it ends.
    pub ends: u64,
    /// First tick.
    pub from: u64,
    /// First tick after it.
    pub to: u64,
}
layout!(FaultWords { what, place, field, axis, first, second, ends, from, to });

/// What was injected so far, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct LiveBoard {
    /// How many they are.
    pub count: u64,
    /// The faults.
    pub faults: [FaultWords; MOST_LIVE],
}
layout!(LiveBoard { count, faults });

impl Default for LiveBoard {
    fn default() -> Self {
        Self { count: 0, faults: [FaultWords::default(); MOST_LIVE] }
    }
}

impl LiveBoard {
    /// The faults; numbers that are none are left out.
    pub fn iter(&self) -> impl Iterator<Item = LiveFault> {
        let count = usize::try_from(self.count).unwrap_or(MOST_LIVE).min(MOST_LIVE);
        self.faults[..count].iter().filter_map(FaultWords::fault)
    }

    /// Takes one more.
    ///
    /// # Errors
    /// [`NotTaken::NoRoom`] where there are [`MOST_LIVE`].
    pub fn push(&mut self, fault: &LiveFault) -> Result<(), NotTaken> {
        let place = usize::try_from(self.count).ok().and_then(|count| self.faults.get_mut(count));
        *place.ok_or(NotTaken::NoRoom)? = FaultWords::of(fault);
        self.count += 1;
        Ok(())
    }
}

impl FaultWords {
    /// A fault in numbers.
    #[must_use]
    pub fn of(fault: &LiveFault) -> Self {
        let LiveFault { trouble, ends, span } = *fault;
        let words = Self { ends: u64::from(ends), from: span.from, to: span.to, ..Self::default() };
        let stage = |what: What, role: Role, first, second| Self {
            what: what as u64,
            place: role as u64,
            first,
            second,
            ..words
        };
        match trouble {
            Trouble::Messages { port, kind } => {
                let place = PORTS.iter().position(|it| *it == port).unwrap_or_default() as u64;
                let words = match kind.place() {
                    Some(Place { field, axis }) => {
                        Self { field: field as u64, axis: axis.map_or(0, |axis| axis as u64 + 1), ..words }
                    }
                    None => words,
                };
                let (what, first, second) = match kind {
                    Kind::Drop(share) => (What::Drop, share.to_bits(), 0),
                    Kind::DropEach { lost, of } => (What::DropEach, lost, of),
                    Kind::Delay(ticks) => (What::Delay, ticks, 0),
                    Kind::Lag(ticks) => (What::Lag, ticks, 0),
                    Kind::Freeze => (What::Freeze, 0, 0),
                    Kind::Noise(_, number) => (What::Noise, number.to_bits(), 0),
                    Kind::Bias(_, number) => (What::Bias, number.to_bits(), 0),
                    Kind::Nan(_) => (What::Nan, 0, 0),
                };
                Self { what: what as u64, place, first, second, ..words }
            }
            Trouble::Late { role, least_ns, most_ns } => stage(What::Late, role, least_ns, most_ns),
            Trouble::Stop { role, for_ns } => stage(What::Stop, role, for_ns, 0),
            Trouble::Kill { role } => stage(What::Kill, role, 0, 0),
            Trouble::Hog { priority } => Self { what: What::Hog as u64, first: priority, ..words },
            Trouble::Load { share } => Self { what: What::Load as u64, first: share.to_bits(), ..words },
        }
    }

    /// The fault; nothing where the numbers are none that a fault may have.
    #[must_use]
    pub fn fault(&self) -> Option<LiveFault> {
        let Self { what, place, first, second, ends, from, to, .. } = *self;
        let at = usize::try_from(place).ok()?;
        let number = f64::from_bits(first);
        let share = (number > 0.0 && number <= 1.0).then_some(number);
        let ticks = (1..=LONGEST_DELAY).contains(&first).then_some(first);
        let role = || STAGES.get(at).copied();
        let port = || PORTS.get(at).copied();
        let struck = || self.struck(port()?);
        let finite = || number.is_finite().then_some(number);
        let messages = |kind| Some(Trouble::Messages { port: port()?, kind });
        let trouble = match What::from_wire(what)? {
            What::Drop => messages(Kind::Drop(share?))?,
            What::DropEach if 1 <= first && first <= second => messages(Kind::DropEach { lost: first, of: second })?,
            What::DropEach => return None,
            What::Delay => messages(Kind::Delay(ticks?))?,
            What::Lag => messages(Kind::Lag(ticks?))?,
            What::Freeze => messages(Kind::Freeze)?,
            What::Noise => messages(Kind::Noise(struck()?, finite()?))?,
            What::Bias => messages(Kind::Bias(struck()?, finite()?))?,
            What::Nan => messages(Kind::Nan(struck()?))?,
            What::Late => Trouble::Late { role: role()?, least_ns: first, most_ns: second },
            What::Stop => Trouble::Stop { role: role()?, for_ns: first },
            What::Kill => Trouble::Kill { role: role()? },
            What::Hog => Trouble::Hog { priority: first },
            What::Load => Trouble::Load { share: share? },
        };
        Some(LiveFault { trouble, ends: ends == 1, span: Span { from, to } })
    }

    /// The number of a port's content that is meant.
    fn struck(&self, port: Port) -> Option<Place> {
        let field = usize::try_from(self.field).ok()?;
        let axes = port.fields().get(field)?.axes.len();
        let axis = usize::try_from(self.axis).ok().filter(|axis| *axis <= axes)?.checked_sub(1);
        Some(Place { field, axis })
    }
}

/// The faults that stages of a flight strike themselves with: those of their messages, and their lateness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopFaults {
    /// Those of messages.
    pub messages: MessageFaults,
    /// The late stages.
    pub late: LateStages,
}

impl LoopFaults {
    /// None.
    #[must_use]
    pub const fn none(seed: u64) -> Self {
        Self { messages: MessageFaults::none(seed), late: LateStages::none(seed) }
    }

    /// Takes one more, or the end of one. What is no stage's own is taken and does nothing here.
    ///
    /// # Errors
    /// [`NotTaken`]; nothing is changed then.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), NotTaken> {
        let LiveFault { trouble, ends, span } = *fault;
        match trouble {
            Trouble::Messages { port, kind } if ends => self.messages.end(port, kind, span.from),
            Trouble::Messages { port, kind } => self.messages.push(MessageFault { port, kind, span }),
            Trouble::Late { role, .. } if ends => self.late.end(role, span.from),
            Trouble::Late { role, least_ns, most_ns } => self.late.push(Late { role, least_ns, most_ns, span }),
            Trouble::Stop { .. } | Trouble::Kill { .. } | Trouble::Hog { .. } | Trouble::Load { .. } => Ok(()),
        }
    }

    /// These with those of a board, which the plant has taken before.
    #[must_use]
    pub fn with(mut self, live: &LiveBoard) -> Self {
        for fault in live.iter() {
            // The plant has refused what cannot be.
            let _ = self.take(&fault);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPAN: Span = Span { from: 10, to: 20 };

    fn every_trouble() -> Vec<Trouble> {
        let (one, all) = (Place { field: 2, axis: Some(1) }, Place { field: 0, axis: None });
        let kinds = [
            Kind::Drop(0.1),
            Kind::DropEach { lost: 2, of: 5 },
            Kind::Delay(60),
            Kind::Lag(1),
            Kind::Freeze,
            Kind::Noise(one, 0.25),
            Kind::Bias(all, -3.0),
            Kind::Nan(one),
        ];
        let messages = PORTS.into_iter().flat_map(|port| kinds.map(|kind| Trouble::Messages { port, kind }));
        let has_field = |trouble: &Trouble| match trouble {
            Trouble::Messages { port, kind } => kind.place().is_none_or(|place| place.field < port.fields().len()),
            _ => true,
        };
        let stages = STAGES.into_iter().flat_map(|role| {
            [Trouble::Late { role, least_ns: 1, most_ns: 9 }, Trouble::Stop { role, for_ns: 5 }, Trouble::Kill { role }]
        });
        let processor = [Trouble::Hog { priority: 90 }, Trouble::Load { share: 0.5 }];
        messages.filter(has_field).chain(stages).chain(processor).collect()
    }

    #[test]
    fn every_fault_comes_back_from_its_numbers() {
        for trouble in every_trouble() {
            for ends in [false, true] {
                let fault = LiveFault { trouble, ends, span: SPAN };
                assert_eq!(FaultWords::of(&fault).fault(), Some(fault));
            }
        }
    }

    #[test]
    fn numbers_that_are_no_fault_are_none() {
        let words = |trouble| FaultWords::of(&LiveFault { trouble, ends: false, span: SPAN });
        let drop = words(Trouble::Messages { port: Port::OuterState, kind: Kind::Drop(0.1) });
        let noise = words(Trouble::Messages {
            port: Port::MixerWrench,
            kind: Kind::Noise(Place { field: 1, axis: Some(2) }, 1.0),
        });
        for broken in [
            FaultWords { what: 0, ..drop },
            FaultWords { what: 14, ..drop },
            FaultWords { place: 5, ..drop },
            FaultWords { first: 1.5_f64.to_bits(), ..drop },
            FaultWords { first: f64::NAN.to_bits(), ..drop },
            FaultWords { what: 2, first: 3, second: 2, ..drop },
            FaultWords { what: 3, first: 61, ..drop },
            FaultWords { what: 4, first: 0, ..drop },
            FaultWords { field: 2, ..noise },
            FaultWords { axis: 4, ..noise },
            FaultWords { first: f64::INFINITY.to_bits(), ..noise },
            FaultWords { what: 9, place: 4, ..drop },
        ] {
            assert_eq!(broken.fault(), None, "{broken:?}");
        }
    }

    #[test]
    fn a_board_is_taken_in_its_order_and_has_so_many_places() {
        let trouble = Trouble::Messages { port: Port::OuterState, kind: Kind::Drop(0.1) };
        let fault = |ends, from| LiveFault { trouble, ends, span: Span { from, to: Span::FOR_GOOD } };
        let mut board = LiveBoard::default();
        board.push(&fault(false, 10)).unwrap();
        board.push(&fault(true, 20)).unwrap();
        board.push(&fault(false, 30)).unwrap();
        let faults = LoopFaults::none(7).with(&board);
        let spans: Vec<Span> = faults.messages.iter().map(|(_, fault)| fault.span).collect();
        assert_eq!(spans, [Span { from: 10, to: 20 }, Span { from: 30, to: Span::FOR_GOOD }]);
        (3..MOST_LIVE).for_each(|_| board.push(&fault(true, 40)).unwrap());
        assert_eq!(board.push(&fault(true, 40)), Err(NotTaken::NoRoom));
        assert_eq!(LiveBoard { count: u64::MAX, ..board }.iter().count(), MOST_LIVE);
    }
}
