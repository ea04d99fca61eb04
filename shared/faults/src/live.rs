//! Faults that are injected into a running flight, and the rules of process faults, planned or injected.
//!
//! The plant puts injected faults on the blackboard [`LIVE`] before it publishes the state of the tick in which it accepted
//! them, so a stage that has this state has them too. They act [`NOTICE_TICKS`] later at the earliest: by then an input
//! knows as many earlier messages as any fault looks back to, and the flight is the same as if they had been planned.

use crate::code::FaultCode;
pub use crate::kind::{FaultKind, LiveFault};
use crate::plan::periods;
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
                .filter(|other| other.kind.is_ended_by(&fault.kind) && is_ended(other.span))
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
    /// Refuses a fault where two faults of a stage would meet, or two of a kind elsewhere; where a stop is shorter than a
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
            let period_s = sample_time_ns.max(1) as f64 / 1e9;
            let ticks = (periods(ns, period_s) as u64).max(1);
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
    use crate::grammar::Fault;
    use FaultRefusal::{Contradiction, NoRoom, NothingToEnd, UnderATick};

    const MS: u64 = 1_000_000;

    /// The fault of a text, in ticks of a millisecond.
    fn fault(text: &str) -> LiveFault {
        let fault: Fault = text.parse().unwrap();
        let span = fault.span(1e-3).unwrap();
        fault.changes[0].faults(span).next().unwrap()
    }

    /// Takes one after the other, each with what is expected of it; returns what is left.
    fn take(faults: &[(&str, Result<(), FaultRefusal>)]) -> LoopFaults {
        let mut taken = LoopFaults::none(7, MS);
        for (text, expected) in faults {
            assert_eq!(taken.take(&fault(text)), *expected, "{text}");
        }
        taken
    }

    fn spans<const MOST: usize>(faults: &FaultList<MOST>) -> Vec<(u64, u64)> {
        let spans = faults.iter().map(|(_, it)| (it.span.from, it.span.to));
        spans.collect()
    }

    #[test]
    fn faults_contradict_each_other_in_the_same_messages_and_numbers_alone() {
        let bias = "outer.state.position_w_m.y.bias=1@tick10..tick20";
        let drop = "outer.state.drop=0.1@tick10..tick20";
        for (first, second, expected) in [
            (drop, "outer.state.drop=1/2@tick19", Err(Contradiction)),
            (drop, "outer.state.drop=0.2@tick20", Ok(())),
            (drop, "inner.state.drop=0.2@tick10", Ok(())),
            (drop, "outer.state.delay=3@tick10", Ok(())),
            (
                bias,
                "outer.state.position_w_m.bias=1@tick10",
                Err(Contradiction),
            ),
            (bias, "outer.state.position_w_m.z.bias=1@tick10", Ok(())),
            (bias, "outer.state.position_w_m.y.noise=1@tick10", Ok(())),
            (bias, "outer.state.velocity_w_m_s.bias=1@tick10", Ok(())),
        ] {
            take(&[(first, Ok(())), (second, expected)]);
        }
    }

    #[test]
    fn a_fault_is_ended_by_its_name_whatever_its_value() {
        let mut faults = take(&[
            ("outer.state.drop=0.1@tick10", Ok(())),
            ("inner.state.drop=0.1@tick10", Ok(())),
            ("outer.state.delay=off@tick20", Err(NothingToEnd)),
            ("outer.state.drop=off@tick20", Ok(())),
            ("outer.state.drop=off@tick20", Err(NothingToEnd)),
            ("inner.state.drop=off@tick5", Ok(())),
            ("inner.state.drop=off@tick5", Err(NothingToEnd)),
            // All axes end one, and one does not end all.
            ("outer.state.position_w_m.z.bias=1@tick10", Ok(())),
            ("outer.state.position_w_m.bias=off@tick20", Ok(())),
            ("outer.state.velocity_w_m_s.bias=1@tick10", Ok(())),
            (
                "outer.state.velocity_w_m_s.z.bias=off@tick20",
                Err(NothingToEnd),
            ),
        ]);
        // A fault that was ended before it began never acts, and contradicts nothing.
        let (ended, not_begun, not_ended) = ((10, 20), (10, 10), (10, Span::FOR_GOOD));
        assert_eq!(
            spans(&faults.messages),
            [ended, not_begun, ended, not_ended]
        );
        let again = fault("inner.state.drop=0.1@tick10");
        assert_eq!(faults.take(&again), Ok(()));
        assert_eq!(faults.take(&again), Err(Contradiction));
    }

    #[test]
    fn a_flight_has_room_for_so_many() {
        let mut faults = LoopFaults::none(7, MS);
        assert!(faults.messages.is_empty() && faults.processes.is_empty());
        for (name, most) in [
            ("mixer.wrench.freeze", MAX_MESSAGE_FAULTS),
            ("plant.late=1ms", MAX_LIVE_FAULTS),
        ] {
            let at = |tick| fault(&format!("{name}@tick{tick}..tick{}", tick + 1));
            (0..most).for_each(|tick| faults.take(&at(tick)).unwrap());
            assert_eq!(faults.take(&at(most)), Err(NoRoom), "{name}");
            let off = fault(&format!("{}=off@tick0", name.split('=').next().unwrap()));
            assert_eq!(faults.take(&off), Ok(()), "{name}");
        }
        let numbers = faults.messages.of(Port::MixerWrench);
        assert!(
            numbers
                .map(|(number, _)| number)
                .eq(0..MAX_MESSAGE_FAULTS as u64)
        );
        assert_eq!(faults.messages.of(Port::OuterState).count(), 0);
    }

    #[test]
    fn a_board_is_taken_in_its_order_and_has_so_many_places() {
        let mut board = LiveBlackboard::default();
        for text in ["drop=0.1@tick10", "drop=off@tick20", "drop=0.1@tick30"] {
            board.push(&fault(&format!("outer.state.{text}"))).unwrap();
        }
        let faults = LoopFaults::none(7, MS).with(&board);
        assert_eq!(spans(&faults.messages), [(10, 20), (30, Span::FOR_GOOD)]);
        let off = fault("outer.state.drop=off@tick40");
        (3..MAX_LIVE_FAULTS).for_each(|_| board.push(&off).unwrap());
        assert_eq!(board.push(&off), Err(NoRoom));
        board.count = u64::MAX;
        assert_eq!(board.iter().count(), MAX_LIVE_FAULTS);
    }

    #[test]
    fn a_stage_is_late_in_its_ticks_by_a_time_within_the_range_until_it_is_ended() {
        let mut faults = take(&[("inner.late=40us..400us@tick10..tick1010", Ok(()))]);
        let late_ns = |tick| faults.late_ns(Role::Inner, tick);
        let times: Vec<u64> = (10..1010).map(late_ns).collect();
        assert!(times.iter().all(|ns| (40_000..400_000).contains(ns)));
        assert!(times.iter().any(|ns| *ns < 60_000) && times.iter().any(|ns| *ns > 380_000));
        assert_eq!([9, 1010].map(late_ns), [0, 0]);
        assert_eq!(faults.late_ns(Role::Outer, 100), 0);
        assert!(faults.is_late(Role::Inner) && !faults.is_late(Role::Outer));
        let is_ended = faults.take(&fault("inner.late=off@tick100"));
        assert_eq!(is_ended, Ok(()));
        assert!(faults.late_ns(Role::Inner, 99) > 0);
        assert_eq!(faults.late_ns(Role::Inner, 100), 0);
    }

    #[test]
    fn a_stage_has_one_fault_at_a_time() {
        take(&[
            ("inner.stop=20ms@tick100", Ok(())),
            // Its end would cut the other short.
            ("inner.stop=500ms@tick119", Err(Contradiction)),
            ("inner.stop=5ms@tick120", Ok(())),
            ("inner.late=1ms@tick90..tick101", Err(Contradiction)),
            ("inner.kill@tick110", Err(Contradiction)),
            ("b.inner.kill@tick110", Err(Contradiction)),
            ("mixer.kill@tick110", Ok(())),
            ("mixer.stop=1ms@tick209", Err(Contradiction)),
            ("mixer.stop=1ms@tick210", Ok(())),
            ("inner.late=1ms@tick200..tick900", Ok(())),
            ("inner.late=2ms@tick500..tick600", Err(Contradiction)),
            ("mixer.late=2ms@tick500..tick600", Ok(())),
            ("outer.late=off@tick300", Err(NothingToEnd)),
            ("inner.late=off@tick300", Ok(())),
            ("inner.late=off@tick300", Err(NothingToEnd)),
            // All channels end the fault of one, and one does not end that of all.
            ("b.inner.late=1ms@tick1000..tick2000", Ok(())),
            ("a.inner.late=off@tick1100", Err(NothingToEnd)),
            ("inner.late=off@tick1100", Ok(())),
            ("mixer.late=1ms@tick1000..tick2000", Ok(())),
            ("b.mixer.late=off@tick1100", Err(NothingToEnd)),
            ("inner.stop=1ms@tick300", Ok(())),
            ("b.outer.stop=1ms@tick300", Ok(())),
            ("c.outer.stop=1ms@tick300", Ok(())),
            ("b.switch@tick300", Ok(())),
            ("b.switch@tick300", Err(Contradiction)),
            ("c.switch@tick300", Ok(())),
        ]);
    }

    #[test]
    fn what_is_not_on_is_not_ended_and_what_is_ended_is_not_on() {
        let faults = take(&[
            ("cpu.hog=off@tick100", Err(NothingToEnd)),
            ("cpu.hog=90@tick50..tick90", Ok(())),
            // Its time is over by then.
            ("cpu.hog=off@tick90", Err(NothingToEnd)),
            ("cpu.hog=90@tick200", Ok(())),
            ("cpu.load=off@tick100", Err(NothingToEnd)),
            ("cpu.hog=off@tick100", Ok(())),
            ("cpu.hog=off@tick101", Err(NothingToEnd)),
        ]);
        assert_eq!(spans(&faults.processes), [(50, 90), (200, 200)]);
    }

    #[test]
    fn the_processor_has_one_hog_and_one_load_at_a_time() {
        take(&[
            ("cpu.hog=90@tick100", Ok(())),
            ("cpu.hog=1@tick200..tick300", Err(Contradiction)),
            ("cpu.load=0.5@tick200..tick300", Ok(())),
            ("cpu.load=0.1@tick299..tick400", Err(Contradiction)),
            ("cpu.hog=1@tick50..tick100", Ok(())),
            ("cpu.hog=off@tick250", Ok(())),
            ("cpu.hog=1@tick250..tick300", Ok(())),
        ]);
    }

    #[test]
    fn a_stop_takes_a_tick_at_least() {
        for (tick_ns, text, expected) in [
            (MS, "inner.stop=999999ns@tick9", Err(UnderATick)),
            (MS, "inner.stop=1ms@tick9", Ok(())),
            (2 * MS, "inner.stop=1ms@tick9", Err(UnderATick)),
            (200 * MS, "inner.kill@tick9", Ok(())),
        ] {
            assert_eq!(
                LoopFaults::none(7, tick_ns).take(&fault(text)),
                expected,
                "{text}"
            );
        }
    }
}
