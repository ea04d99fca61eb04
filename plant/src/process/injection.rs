//! The faults of a flight, planned and injected, and the blackboard of the latter.

use std::ops::RangeInclusive;

use faults::live::{LIVE, LiveBlackboard, LiveFault, LoopFaults, NOTICE_TICKS};
use faults::{FaultRefusal, MessageFaults, Span};
use ipc::clock::busy_wait;
use ipc::error::Error;
use ipc::{Blackboard, Wire};
use messages::role::{Channel, Role};

/// The faults of a flight, as its plant has them.
pub struct Injection {
    faults: LoopFaults,
    live: LiveBlackboard,
    board: Blackboard<LiveBlackboard>,
    /// Whether the plant itself is late in some tick.
    is_late: bool,
    has_switches: bool,
    /// How much longer than in flight a tick takes on the clock.
    pub slowdown: u64,
    /// The last tick of the flight: no fault begins after it.
    pub last_tick: u64,
}

impl Injection {
    /// No faults, and an empty blackboard.
    pub fn none(wire: &Wire, seed: u64, sample_time_ns: u64) -> Result<Self, Error> {
        let (board, live) = (wire.blackboard(LIVE)?, LiveBlackboard::default());
        board.put(live);
        Ok(Self {
            faults: LoopFaults::none(seed, sample_time_ns),
            live,
            board,
            is_late: false,
            has_switches: false,
            slowdown: 1,
            last_tick: u64::MAX,
        })
    }

    pub fn plan(&mut self, faults: &LoopFaults) {
        self.faults = *faults;
        self.is_late = faults.is_late(Role::Plant);
        let has_switches = self.switches().next().is_some();
        self.has_switches = has_switches;
    }

    fn switches(&self) -> impl Iterator<Item = (u64, Channel)> {
        let processes = self.faults.processes.iter();
        processes.filter_map(|(_, fault)| Some((fault.span.from, fault.kind.switch()?)))
    }

    pub const fn messages(&self) -> &MessageFaults {
        &self.faults.messages
    }

    /// Adds faults from a tick on, at a tick of which nothing has been published: a stage that hears of the tick finds
    /// them on the blackboard. Gives their ticks, or the first fault that is refused, and why; nothing is changed then.
    #[cold]
    pub fn inject(
        &mut self,
        faults: &[LiveFault],
        first_tick: u64,
        for_ticks: u64,
        tick: u64,
    ) -> Result<Span, (usize, FaultRefusal)> {
        let from = first_tick.max(tick.saturating_add(NOTICE_TICKS));
        let span = Span::new(from, from.saturating_add(for_ticks));
        if from > self.last_tick {
            return Err((0, FaultRefusal::AfterTheEnd));
        }
        let (mut loops, mut live) = (self.faults, self.live);
        for (which, fault) in faults.iter().enumerate() {
            let span = fault.span_from(span);
            let fault = LiveFault { span, ..*fault };
            loops
                .take(&fault)
                .and_then(|()| live.push(&fault))
                .map_err(|reason| (which, reason))?;
        }
        self.plan(&loops);
        self.live = live;
        self.board.put(live);
        Ok(span)
    }

    /// The last channel that is requested to fly from one of these ticks on, and that tick.
    pub fn switch(&self, ticks: RangeInclusive<u64>) -> Option<(u64, Channel)> {
        if !self.has_switches {
            return None;
        }
        let due = self.switches().filter(|(from, _)| ticks.contains(from));
        due.max_by_key(|(from, _)| *from)
    }

    /// Computes for as much longer as a fault says.
    pub fn be_late(&self, tick: u64) {
        if self.is_late {
            let late_ns = self.faults.late_ns(Role::Plant, tick);
            busy_wait(self.slowdown.saturating_mul(late_ns));
        }
    }
}
