//! Faults that are injected into a running flight, and when they take effect.
//!
//! The plant puts them on the board [`LIVE`] before it publishes the state of the tick in which it took them in. A stage
//! that has heard of that tick has them too. They take hold [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the same fault is the same flight as if it had been
//! planned.

use crate::fault::code::FaultCode;
pub use crate::fault::code::{FaultKind, HIGHEST_PRIORITY, LONGEST_NS, LiveFault};
use crate::fault::late::{Late, LateStages};
use crate::fault::{LONGEST_DELAY, MessageFault, MessageFaults, NotTaken};
use crate::layout::layout;

/// Name of the plant's board with the [`LiveBlackboard`].
pub const LIVE: &str = "faults";

/// Faults that can be injected into one flight, each counted as often as it has inputs; an end counts as one, too.
pub const MOST_LIVE: usize = 64;

/// Ticks from the plant's taking in a fault to the first one that it strikes, at the least.
pub const NOTICE_TICKS: u64 = LONGEST_DELAY + 4;

/// What was injected so far, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct LiveBlackboard {
    pub count: u64,
    pub faults: [FaultCode; MOST_LIVE],
}
layout!(LiveBlackboard { count, faults });

impl Default for LiveBlackboard {
    fn default() -> Self {
        Self {
            count: 0,
            faults: [FaultCode::default(); MOST_LIVE],
        }
    }
}

impl LiveBlackboard {
    /// The faults; numbers that are none are left out.
    pub fn iter(&self) -> impl Iterator<Item = LiveFault> {
        let count = usize::try_from(self.count)
            .unwrap_or(MOST_LIVE)
            .min(MOST_LIVE);
        self.faults[..count].iter().filter_map(FaultCode::fault)
    }

    pub fn push(&mut self, fault: &LiveFault) -> Result<(), NotTaken> {
        let place = usize::try_from(self.count)
            .ok()
            .and_then(|count| self.faults.get_mut(count));
        *place.ok_or(NotTaken::NoRoom)? = FaultCode::of(fault);
        self.count += 1;
        Ok(())
    }
}

/// The faults that stages of a flight strike themselves with: those of their messages, and their lateness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopFaults {
    pub messages: MessageFaults,
    pub late: LateStages,
}

impl LoopFaults {
    #[must_use]
    pub const fn none(seed: u64) -> Self {
        Self {
            messages: MessageFaults::none(seed),
            late: LateStages::none(seed),
        }
    }

    /// Takes one more, or the end of one. What is no stage's own is taken and does nothing here.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), NotTaken> {
        let LiveFault {
            trouble,
            ends,
            span,
        } = *fault;
        match trouble {
            FaultKind::Messages { port, kind } if ends => self.messages.end(port, kind, span.from),
            FaultKind::Messages { port, kind } => {
                self.messages.push(MessageFault { port, kind, span })
            }
            FaultKind::Late { role, .. } if ends => self.late.end(role, span.from),
            FaultKind::Late {
                role,
                least_ns,
                most_ns,
            } => self.late.push(Late {
                role,
                least_ns,
                most_ns,
                span,
            }),
            FaultKind::Stop { .. }
            | FaultKind::Kill { .. }
            | FaultKind::Hog { .. }
            | FaultKind::Load { .. } => Ok(()),
        }
    }

    /// These with those of a board, which the plant has taken before.
    #[must_use]
    pub fn with(mut self, live: &LiveBlackboard) -> Self {
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
    use crate::fault::{Kind, Port, Span};

    #[test]
    fn a_board_is_taken_in_its_order_and_has_so_many_places() {
        let trouble = FaultKind::Messages {
            port: Port::OuterState,
            kind: Kind::Drop(0.1),
        };
        let fault = |ends, from| LiveFault {
            trouble,
            ends,
            span: Span {
                from,
                to: Span::FOR_GOOD,
            },
        };
        let mut board = LiveBlackboard::default();
        board.push(&fault(false, 10)).unwrap();
        board.push(&fault(true, 20)).unwrap();
        board.push(&fault(false, 30)).unwrap();
        let faults = LoopFaults::none(7).with(&board);
        let spans: Vec<Span> = faults
            .messages
            .iter()
            .map(|(_, fault)| fault.span)
            .collect();
        assert_eq!(
            spans,
            [
                Span { from: 10, to: 20 },
                Span {
                    from: 30,
                    to: Span::FOR_GOOD
                }
            ]
        );
        (3..MOST_LIVE).for_each(|_| board.push(&fault(true, 40)).unwrap());
        assert_eq!(board.push(&fault(true, 40)), Err(NotTaken::NoRoom));
        assert_eq!(
            LiveBlackboard {
                count: u64::MAX,
                ..board
            }
            .iter()
            .count(),
            MOST_LIVE
        );
    }
}
