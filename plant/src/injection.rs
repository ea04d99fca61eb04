//! What goes wrong in the loop: what was planned, what was injected in flight, and the board of the latter.

use faults::live::{Acts, LIVE, LiveBlackboard, LiveFault, LoopFaults, NOTICE_TICKS};
use faults::{FaultRefusal, MessageFaults, Span};
use ipc::clock::busy_wait;
use ipc::error::Error;
use ipc::{Blackboard, Wire};
use messages::content::RotorSpeeds;
use messages::role::Role;

use crate::parameter_server::{Event, FaultRequest};
use crate::plant::Plant;

/// The faults of a flight, as its plant has them.
#[allow(
    missing_debug_implementations,
    reason = "the middleware's handle has none"
)]
pub struct Injection {
    faults: LoopFaults,
    acts: Acts,
    live: LiveBlackboard,
    board: Blackboard<LiveBlackboard>,
    /// Whether the plant itself is late in some tick.
    is_late: bool,
    /// How much longer than in flight a tick takes on the clock.
    pub slowdown: u64,
    /// The last tick of the flight: nothing strikes behind it.
    pub last_tick: u64,
}

impl Injection {
    /// No faults, on a board that says so.
    pub fn none(wire: &Wire, seed: u64, sample_time_ns: u64) -> Result<Self, Error> {
        let (board, live) = (wire.blackboard(LIVE)?, LiveBlackboard::default());
        board.put(live);
        let (faults, acts) = (LoopFaults::none(seed), Acts::none(sample_time_ns));
        Ok(Self {
            faults,
            acts,
            live,
            board,
            is_late: false,
            slowdown: 1,
            last_tick: u64::MAX,
        })
    }

    pub fn plan(&mut self, faults: &LoopFaults, acts: &Acts) {
        (self.faults, self.acts) = (*faults, *acts);
        self.is_late = !faults.late.of(Role::Plant).is_empty();
    }

    pub const fn messages(&self) -> &MessageFaults {
        &self.faults.messages
    }

    /// Takes an order in, at a tick of which nothing has been published: whoever hears of it finds this on the board.
    /// Says what became of it. `newest` is the plant's newest command, where one has come.
    #[cold]
    pub fn strike(
        &mut self,
        order: &FaultRequest,
        tick: u64,
        plant: &mut Plant,
        newest: Option<RotorSpeeds>,
    ) -> Event {
        let asked = order
            .tick
            .unwrap_or_else(|| tick.saturating_add(order.in_ticks));
        let from = asked.max(tick.saturating_add(NOTICE_TICKS));
        let (ticket, span) = (
            order.ticket,
            Span {
                from,
                to: from.saturating_add(order.for_ticks),
            },
        );
        if from > self.last_tick {
            return Event::FaultRefused {
                ticket,
                which: 0,
                reason: FaultRefusal::AfterTheEnd,
            };
        }
        let (mut faults, mut acts, mut live) = (self.faults, self.acts, self.live);
        for (which, fault) in order.faults.iter().enumerate() {
            let fault = LiveFault {
                span: fault.span_from(span),
                ..*fault
            };
            let taken = faults
                .take(&fault)
                .and_then(|()| acts.take(&fault))
                .and_then(|()| live.push(&fault));
            if let Err(reason) = taken {
                return Event::FaultRefused {
                    ticket,
                    which,
                    reason,
                };
            }
        }
        self.plan(&faults, &acts);
        plant.change_faults(&faults.messages, newest);
        self.live = live;
        self.board.put(live);
        Event::Strikes { ticket, span }
    }

    /// Computes for as much longer as a fault says.
    pub fn be_late(&self, tick: u64) {
        if self.is_late {
            busy_wait(
                self.slowdown
                    .saturating_mul(self.faults.late.late_ns(Role::Plant, tick)),
            );
        }
    }
}
