//! Faults that are injected into a running flight, and the rules of process faults, planned or injected.
//!
//! The plant puts injected faults on the blackboard [`LIVE`] before it publishes the state of the tick in which it accepted
//! them, so a stage that has this state has them too. They act [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the flight is the same as if they had been planned.

use crate::code::FaultCode;
pub use crate::kind::{FaultKind, LiveFault};
use crate::{FaultRefusal, LONGEST_DELAY_TICKS, Port, Span, StageTicks};
use messages::layout::{layout, zeroed};
use messages::noise::uniform;
use messages::role::{Replica, Role};

/// Faults of messages that one flight can have, counted by input: `state.drop` makes two of them.
pub const MAX_MESSAGE_FAULTS: usize = 32;

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

/// Faults of one sort in a flight, and the seed of what is random in them.
///
/// The place of a fault is its number: what it draws depends on seed, number and tick alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultList<const MOST: usize> {
    pub seed: u64,
    faults: [Option<LiveFault>; MOST],
}

pub type MessageFaults = FaultList<MAX_MESSAGE_FAULTS>;

impl<const MOST: usize> FaultList<MOST> {
    pub const fn none(seed: u64) -> Self {
        let faults = [None; MOST];
        Self { seed, faults }
    }

    /// Adds a fault, or ends those like it from its first tick on; the value of an end means nothing.
    fn take(
        &mut self,
        fault: &LiveFault,
        contradicts: impl Fn(&LiveFault) -> bool,
    ) -> Result<(), FaultRefusal> {
        let mut others = self.faults.iter_mut().flatten();
        if fault.ends {
            let end = fault.span.from;
            let is_ended = |Span { from, to }| to > end && from < to;
            let mut ended = others
                .filter(|other| other.kind.is_like(&fault.kind) && is_ended(other.span))
                .peekable();
            ended.peek().ok_or(FaultRefusal::NothingToEnd)?;
            ended.for_each(|other| other.span = other.span.cut(end));
            return Ok(());
        }
        if others.any(|other| contradicts(other)) {
            return Err(FaultRefusal::Contradiction);
        }
        let place = self.faults.iter_mut().find(|place| place.is_none());
        *place.ok_or(FaultRefusal::NoRoom)? = Some(*fault);
        Ok(())
    }

    /// All of them, each with its number.
    pub fn iter(&self) -> impl Iterator<Item = (u64, &LiveFault)> {
        (0..)
            .zip(&self.faults)
            .filter_map(|(number, fault)| Some((number, fault.as_ref()?)))
    }

    /// The faults of the messages at an input, each with its number.
    pub fn of(&self, input: Port) -> impl Iterator<Item = (u64, &LiveFault)> {
        self.iter()
            .filter(move |(_, fault)| fault.kind.port() == Some(input))
    }

    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }
}

/// The faults of a flight, planned and injected, other than changes of its airframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopFaults {
    pub messages: MessageFaults,
    /// Of stages, their processor and channels.
    pub processes: FaultList<MAX_LIVE_FAULTS>,
    sample_time_ns: u64,
}

impl LoopFaults {
    /// Nothing, in a flight with ticks of so much flight time [ns].
    pub const fn none(seed: u64, sample_time_ns: u64) -> Self {
        Self {
            messages: FaultList::none(seed),
            processes: FaultList::none(seed),
            sample_time_ns,
        }
    }

    /// Takes one more, or the end of one.
    ///
    /// It refuses where two faults of a stage would meet, or two of a kind elsewhere; where a stop is shorter than a
    /// tick; where there is nothing to end, or no room. Nothing is changed then.
    pub fn take(&mut self, fault: &LiveFault) -> Result<(), FaultRefusal> {
        let (LiveFault { kind, span, .. }, sample_time_ns) = (*fault, self.sample_time_ns);
        if matches!(kind.stage_ticks(), Some(StageTicks::Out(ns)) if ns < sample_time_ns) {
            return Err(FaultRefusal::UnderATick);
        }
        let stage_span = |fault: &LiveFault| stage_span(fault, sample_time_ns);
        let contradicts = |other: &LiveFault| match (stage_span(fault), stage_span(other)) {
            (Some(one), Some(two)) => other.kind.overlaps(&kind) && two.overlaps(one),
            _ => other.kind.is_like(&kind) && other.span.overlaps(span),
        };
        match kind.port() {
            Some(_) => self.messages.take(fault, contradicts),
            None => self.processes.take(fault, contradicts),
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

    /// Faults that make a stage compute longer, each with the least and the most [ns].
    fn late(&self) -> impl Iterator<Item = (&LiveFault, [u64; 2])> {
        self.processes
            .iter()
            .filter_map(|(_, fault)| match fault.kind.stage_ticks()? {
                StageTicks::Late(range_ns) => Some((fault, range_ns)),
                StageTicks::Out(_) | StageTicks::Anew(_) => None,
            })
    }

    /// Whether a stage computes longer in some tick.
    pub fn is_late(&self, role: Role) -> bool {
        self.late()
            .any(|(fault, _)| fault.kind.role() == Some(role))
    }

    /// How much longer a stage computes at a tick [ns].
    pub fn late_ns(&self, stage: impl Into<Replica>, tick: u64) -> u64 {
        let stage = stage.into();
        let late = self
            .late()
            .find(|(fault, _)| fault.kind.is_of(stage) && fault.span.contains(tick));
        late.map_or(0, |(_, [least, most])| {
            let range = most.saturating_sub(least) as f64;
            let share = late_share(stage.role, self.processes.seed, tick);
            least.saturating_add((range * share) as u64)
        })
    }
}

/// The ticks in which a fault has its stage not do what it does otherwise; none where it has no stage.
fn stage_span(fault: &LiveFault, sample_time_ns: u64) -> Option<Span> {
    let Span { from, .. } = fault.span;
    Some(match fault.kind.stage_ticks()? {
        StageTicks::Late(_) => fault.span,
        StageTicks::Out(ns) | StageTicks::Anew(ns) => {
            let ticks = (ns / sample_time_ns.max(1)).max(1);
            Span::new(from, from.saturating_add(ticks))
        }
    })
}

/// Streams of random numbers of late stages; those of messages lie below.
const FIRST_STREAM: u64 = 1 << 33;

/// A number in [0, 1) for a stage and a tick of the flight of `seed`: how far it is from the least to the most.
pub fn late_share(role: Role, seed: u64, tick: u64) -> f64 {
    uniform(seed, tick, FIRST_STREAM + role as u64)
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
