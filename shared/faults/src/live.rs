//! Faults that are injected into a running flight, and the rules of process faults, planned or injected.
//!
//! The plant puts injected faults on the blackboard [`LIVE`] before it publishes the state of the tick in which it accepted
//! them, so a stage that has this state has them too. They act [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the flight is the same as if they had been planned.

use crate::code::FaultCode;
pub use crate::code::{FaultKind, HIGHEST_PRIORITY, LONGEST_NS, LiveFault};
use crate::{FaultList, FaultRefusal, LONGEST_DELAY_TICKS, MessageFaults, Span};
use messages::layout::{layout, zeroed};
use messages::noise::uniform;
use messages::role::{Replica, Role};

/// Name of the plant's blackboard with the [`LiveBlackboard`].
pub const LIVE: &str = "faults";

/// Faults that can be injected into one flight, each counted as often as it has inputs; an end counts as one, too.
pub const MAX_LIVE_FAULTS: usize = 64;

/// Ticks from the one in which the plant accepts a fault to its first one, at the least.
pub const NOTICE_TICKS: u64 = LONGEST_DELAY_TICKS + 4;

layout! {
    /// What was injected so far, in order.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct LiveBlackboard {
        pub count: u64,
        pub faults: [FaultCode; MAX_LIVE_FAULTS],
    }
}

impl Default for LiveBlackboard {
    fn default() -> Self {
        zeroed()
    }
}

impl LiveBlackboard {
    /// The faults; numbers that are none are left out.
    pub fn iter(&self) -> impl Iterator<Item = LiveFault> {
        let count = usize::try_from(self.count)
            .unwrap_or(MAX_LIVE_FAULTS)
            .min(MAX_LIVE_FAULTS);
        self.faults[..count].iter().filter_map(FaultCode::fault)
    }

    pub fn push(&mut self, fault: &LiveFault) -> Result<(), FaultRefusal> {
        let place = usize::try_from(self.count)
            .ok()
            .and_then(|count| self.faults.get_mut(count));
        *place.ok_or(FaultRefusal::NoRoom)? = FaultCode::of(fault);
        self.count += 1;
        Ok(())
    }
}

/// The faults that stages inject themselves: of their messages, and their lateness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopFaults {
    pub messages: MessageFaults,
    pub late: FaultList,
}

impl LoopFaults {
    pub const fn none(seed: u64) -> Self {
        Self {
            messages: MessageFaults::none(seed),
            late: FaultList::none(seed),
        }
    }

    /// Takes one more, or the end of one. What is no stage's own is taken and does nothing here.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), FaultRefusal> {
        match fault.kind {
            FaultKind::Messages { .. } => self.messages.take(fault),
            FaultKind::Late { .. } => self.late.take(fault),
            _ => Ok(()),
        }
    }

    /// These with those of a blackboard, which the plant has taken before.
    pub fn with(mut self, live: &LiveBlackboard) -> Self {
        for fault in live.iter() {
            // The plant has refused what cannot be.
            let _ = self.take(&fault);
        }
        self
    }
}

/// Streams of random numbers of late stages; those of messages lie below.
const FIRST_STREAM: u64 = 1 << 33;

/// A number in [0, 1) for a stage and a tick of the flight of `seed`: how far it is from the least to the most.
pub fn late_share(role: Role, seed: u64, tick: u64) -> f64 {
    uniform(seed, tick, FIRST_STREAM + role as u64)
}

impl FaultList {
    /// How much longer a stage computes at a tick [ns].
    pub fn late_ns(&self, stage: impl Into<Replica>, tick: u64) -> u64 {
        let stage = stage.into();
        let late = self.iter().find_map(|(_, fault)| match fault.kind {
            FaultKind::Late { range_ns, .. }
                if fault.kind.is_of(stage) && fault.span.contains(tick) =>
            {
                Some(range_ns)
            }
            _ => None,
        });
        late.map_or(0, |[least, most]| {
            let range = most.saturating_sub(least) as f64;
            least.saturating_add((range * late_share(stage.role, self.seed, tick)) as u64)
        })
    }
}

/// How long a stage that was killed takes until it works again [ns]: a launcher that lets nothing start anew within
/// 50 ms, and a process that is ready well within as much again.
pub const RESTART_NS: u64 = 100_000_000;

/// What is done to processes in a flight, in the order in which it was planned or injected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acts {
    sample_time_ns: u64,
    acts: [Option<LiveFault>; MAX_LIVE_FAULTS],
}

impl Acts {
    /// Nothing, in a flight with ticks of so much flight time [ns].
    pub const fn none(sample_time_ns: u64) -> Self {
        Self {
            sample_time_ns,
            acts: [None; MAX_LIVE_FAULTS],
        }
    }

    /// Takes one more, or the end of one. Faults of messages are taken and do nothing here.
    ///
    /// It refuses where two faults of a stage would meet, or two hogs or loads; where a stop is shorter than a tick;
    /// where there is nothing to end, or where there are [`MAX_LIVE_FAULTS`]. Nothing is changed then.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), FaultRefusal> {
        let LiveFault { kind, ends, span } = *fault;
        if matches!(kind, FaultKind::Messages { .. }) {
            return Ok(());
        }
        if matches!(kind, FaultKind::Stop { for_ns, .. } if for_ns < self.sample_time_ns) {
            return Err(FaultRefusal::UnderATick);
        }
        let own = self.outage(fault);
        let contradicts = |other: &LiveFault| match (own, self.outage(other)) {
            (Some(own), Some(span)) => other.kind.overlaps(&kind) && span.overlaps(own),
            (_, None) => other.kind.is_like(&kind) && other.span.overlaps(span),
            (None, _) => false,
        };
        if !ends && self.begun().any(contradicts) {
            return Err(FaultRefusal::Contradiction);
        }
        let is_meant = |other: &LiveFault| {
            let Span { from, to } = other.span;
            other.kind.is_like(&kind) && to > span.from && from < to
        };
        if ends && !self.begun().any(is_meant) {
            return Err(FaultRefusal::NothingToEnd);
        }
        let place = self
            .acts
            .iter()
            .position(Option::is_none)
            .ok_or(FaultRefusal::NoRoom)?;
        if ends {
            let meant = self
                .acts
                .iter_mut()
                .flatten()
                .filter(|other| !other.ends && is_meant(other));
            meant.for_each(|other| other.span = other.span.cut(span.from));
        }
        self.acts[place] = Some(*fault);
        Ok(())
    }

    /// What is begun, up to its end; ends are not among it.
    pub fn begun(&self) -> impl Iterator<Item = &LiveFault> {
        self.acts.iter().flatten().filter(|fault| !fault.ends)
    }

    /// The ticks in which a fault has its stage not do what it does otherwise; none where it has no stage.
    fn outage(&self, fault: &LiveFault) -> Option<Span> {
        let Span { from, .. } = fault.span;
        let ticks = |ns: u64| (ns / self.sample_time_ns.max(1)).max(1);
        let out = |ns| Span {
            from,
            to: from.saturating_add(ticks(ns)),
        };
        let span = match fault.kind {
            FaultKind::Stop { for_ns, .. } => out(for_ns),
            FaultKind::Kill { .. } => out(RESTART_NS),
            _ => fault.span,
        };
        fault.kind.role().map(|_| span)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Kind, Port};

    const HOG: FaultKind = FaultKind::Hog { priority: 90 };
    const OTHER_HOG: FaultKind = FaultKind::Hog { priority: 1 };
    const LOAD: FaultKind = FaultKind::Load { share: 0.5 };
    const MS: u64 = 1_000_000;
    const CONTRADICTION: Result<(), FaultRefusal> = Err(FaultRefusal::Contradiction);
    const NOTHING: Result<(), FaultRefusal> = Err(FaultRefusal::NothingToEnd);

    fn live(kind: FaultKind, ends: bool, from: u64, to: u64) -> LiveFault {
        let span = Span { from, to };
        LiveFault { kind, ends, span }
    }

    fn fault(kind: FaultKind, from: u64, to: u64) -> LiveFault {
        live(kind, false, from, to)
    }

    fn off(kind: FaultKind, from: u64) -> LiveFault {
        live(kind, true, from, from + 1)
    }

    fn stop(role: Role, from: u64, for_ns: u64) -> LiveFault {
        fault(
            FaultKind::Stop {
                role,
                channel: None,
                for_ns,
            },
            from,
            from + 1,
        )
    }

    fn late(role: Role) -> FaultKind {
        FaultKind::Late {
            role,
            channel: None,
            range_ns: [40_000, 400_000],
        }
    }

    /// Takes one after the other, each with what is expected of it.
    fn take(faults: &[(LiveFault, Result<(), FaultRefusal>)]) -> Acts {
        let mut acts = Acts::none(MS);
        for (fault, expected) in faults {
            assert_eq!(acts.take(fault), *expected, "{fault:?}");
        }
        acts
    }

    #[test]
    fn a_board_is_taken_in_its_order_and_has_so_many_places() {
        let drop = FaultKind::Messages {
            port: Port::OuterState,
            kind: Kind::Drop(0.1),
        };
        let fault = |ends, from| live(drop, ends, from, Span::FOR_GOOD);
        let mut board = LiveBlackboard::default();
        for (ends, from) in [(false, 10), (true, 20), (false, 30)] {
            board.push(&fault(ends, from)).unwrap();
        }
        let faults = LoopFaults::none(7).with(&board);
        let spans = faults.messages.iter();
        let spans: Vec<_> = spans.map(|(_, it)| (it.span.from, it.span.to)).collect();
        assert_eq!(spans, [(10, 20), (30, Span::FOR_GOOD)]);
        (3..MAX_LIVE_FAULTS).for_each(|_| board.push(&fault(true, 40)).unwrap());
        assert_eq!(board.push(&fault(true, 40)), Err(FaultRefusal::NoRoom));
        board.count = u64::MAX;
        assert_eq!(board.iter().count(), MAX_LIVE_FAULTS);
    }

    #[test]
    fn a_stage_is_late_in_its_ticks_by_a_time_within_the_range_until_it_is_ended() {
        let mut faults = LoopFaults::none(7);
        faults.take(&fault(late(Role::Inner), 10, 1010)).unwrap();
        let lates = faults.late;
        let late_ns = |tick| lates.late_ns(Role::Inner, tick);
        let times: Vec<u64> = (10..1010).map(late_ns).collect();
        assert!(times.iter().all(|ns| (40_000..400_000).contains(ns)));
        assert!(times.iter().any(|ns| *ns < 60_000) && times.iter().any(|ns| *ns > 380_000));
        assert_eq!([9, 1010].map(late_ns), [0, 0]);
        assert_eq!(lates.late_ns(Role::Outer, 100), 0);
        assert_eq!(
            lates.of_role(Role::Inner).late_ns(Role::Inner, 77),
            times[67]
        );
        assert!(lates.of_role(Role::Outer).is_empty() && !lates.is_empty());

        for (fault, expected) in [
            (fault(late(Role::Inner), 500, 600), CONTRADICTION),
            (fault(late(Role::Mixer), 500, 600), Ok(())),
            (off(late(Role::Outer), 100), NOTHING),
            (off(late(Role::Inner), 100), Ok(())),
            (off(late(Role::Inner), 100), NOTHING),
        ] {
            assert_eq!(faults.take(&fault), expected);
        }
        assert!(faults.late.late_ns(Role::Inner, 99) > 0);
        assert_eq!(faults.late.late_ns(Role::Inner, 100), 0);
        let mut ticks = 1..;
        let full = |tick| faults.take(&fault(late(Role::Plant), tick, tick + 1));
        assert!(
            ticks
                .by_ref()
                .map(full)
                .any(|taken| taken == Err(FaultRefusal::NoRoom))
        );
    }

    #[test]
    fn a_stage_has_one_fault_at_a_time() {
        let kill = |role| {
            fault(
                FaultKind::Kill {
                    role,
                    channel: None,
                },
                110,
                111,
            )
        };
        take(&[
            (stop(Role::Inner, 100, 20 * MS), Ok(())),
            // Its end would cut the other short.
            (stop(Role::Inner, 119, 500 * MS), CONTRADICTION),
            (stop(Role::Inner, 120, 5 * MS), Ok(())),
            (fault(late(Role::Inner), 90, 101), CONTRADICTION),
            (kill(Role::Inner), CONTRADICTION),
            (kill(Role::Mixer), Ok(())),
            (stop(Role::Mixer, 209, MS), CONTRADICTION),
            (stop(Role::Mixer, 210, MS), Ok(())),
            (fault(late(Role::Inner), 200, Span::FOR_GOOD), Ok(())),
            (off(late(Role::Inner), 300), Ok(())),
            (stop(Role::Inner, 300, MS), Ok(())),
        ]);
    }

    #[test]
    fn what_is_not_on_is_not_ended_and_what_is_ended_is_not_on() {
        let acts = take(&[
            (off(HOG, 100), NOTHING),
            (fault(HOG, 50, 90), Ok(())),
            // Its time is over by then.
            (off(HOG, 90), NOTHING),
            (fault(HOG, 200, Span::FOR_GOOD), Ok(())),
            (off(LOAD, 100), NOTHING),
            (off(OTHER_HOG, 100), Ok(())),
            (off(HOG, 101), NOTHING),
        ]);
        let left: Vec<_> = acts.begun().map(|it| (it.span.from, it.span.to)).collect();
        assert_eq!(left, [(50, 90), (200, 200)]);
    }

    #[test]
    fn the_processor_has_one_hog_and_one_load_at_a_time() {
        take(&[
            (fault(HOG, 100, Span::FOR_GOOD), Ok(())),
            (fault(OTHER_HOG, 200, 300), CONTRADICTION),
            (fault(LOAD, 200, 300), Ok(())),
            (
                fault(FaultKind::Load { share: 0.1 }, 299, 400),
                CONTRADICTION,
            ),
            (fault(OTHER_HOG, 50, 100), Ok(())),
            (off(HOG, 250), Ok(())),
            (fault(OTHER_HOG, 250, 300), Ok(())),
        ]);
    }

    #[test]
    fn a_stop_takes_a_tick_at_least_and_a_flight_has_room_for_so_many() {
        for (tick_ns, for_ns, expected) in [
            (MS, MS - 1, Err(FaultRefusal::UnderATick)),
            (MS, MS, Ok(())),
            (2 * MS, MS, Err(FaultRefusal::UnderATick)),
        ] {
            let taken = Acts::none(tick_ns).take(&stop(Role::Inner, 100, for_ns));
            assert_eq!(taken, expected);
        }
        let mut acts = Acts::none(MS);
        (0..MAX_LIVE_FAULTS as u64).for_each(|n| acts.take(&stop(Role::Inner, n, MS)).unwrap());
        assert_eq!(
            acts.take(&stop(Role::Inner, 500, MS)),
            Err(FaultRefusal::NoRoom)
        );
        assert_eq!(acts.begun().count(), MAX_LIVE_FAULTS);
    }
}
