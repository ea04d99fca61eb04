//! Faults that are injected into a flight in the air: what they are in words of the wire, and when they take hold.
//!
//! The plant puts them on the board [`LIVE`] before it publishes the state of the tick in which it took them in. A stage
//! that has heard of that tick has them too. They take hold [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the same fault is the same flight as if it had been
//! planned.

mod words;

use crate::fault::late::{Late, LateStages};
use crate::fault::{Kind, LONGEST_DELAY, MessageFault, MessageFaults, NotTaken, Port, Span, is_share};
use crate::layout::layout;
use crate::role::Role;

pub use self::words::{FaultWords, WORDS};

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

/// The longest time that a stage stops or is late [ns]: the airframe is lost long before.
pub const LONGEST_NS: u64 = 60_000_000_000;

/// The highest priority of SCHED_FIFO.
pub const HIGHEST_PRIORITY: u64 = 99;

impl Trouble {
    /// Whether its numbers are ones that a fault may have, planned or injected.
    #[must_use]
    pub fn is_possible(&self) -> bool {
        match *self {
            Self::Messages { kind, .. } => kind.is_possible(),
            Self::Late { least_ns, most_ns, .. } => 1 <= least_ns && least_ns <= most_ns && most_ns <= LONGEST_NS,
            Self::Stop { for_ns, .. } => (1..=LONGEST_NS).contains(&for_ns),
            // A flight ends with its plant.
            Self::Kill { role } => role != Role::Plant,
            Self::Hog { priority } => (1..=HIGHEST_PRIORITY).contains(&priority),
            Self::Load { share } => is_share(share),
        }
    }

    /// Whether it happens once, at an instant, and nothing of it can be ended.
    #[must_use]
    pub const fn is_once(&self) -> bool {
        matches!(self, Self::Stop { .. } | Self::Kill { .. })
    }

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
