//! Joins the messages of a tick, which come by topic.

use std::collections::BTreeMap;

use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use model::telemetry::{LAW_ROLES, Telemetry};

use crate::tick::TickRecord;

/// A state, with what the stages made of it.
#[derive(Clone, Copy, Debug)]
pub struct Joined {
    /// The tick.
    pub tick: u64,
    /// State at the tick.
    pub state: State,
    /// Set-point of the tick; none where none was published.
    pub setpoint: Option<Setpoint>,
    /// Thrust and torque demanded at the tick; none where nobody demanded any.
    pub wrench: Option<Wrench>,
    /// Rotor command of the tick; none where none was published.
    pub rotor_speeds: Option<RotorSpeeds>,
    /// What is said of the theorem; none where nobody could tell.
    pub monitor: Option<Monitor>,
}

impl Joined {
    /// What outer, inner and mixer law showed at the tick; none of a stage that published nothing.
    #[must_use]
    pub fn telemetry(&self) -> [Option<&Telemetry>; LAW_ROLES.len()] {
        [
            self.setpoint.as_ref().map(|setpoint| &setpoint.telemetry),
            self.wrench.as_ref().map(|wrench| &wrench.telemetry),
            self.rotor_speeds.as_ref().map(|speeds| &speeds.telemetry),
        ]
    }
}

impl From<&TickRecord> for Joined {
    fn from(record: &TickRecord) -> Self {
        let TickRecord { tick, state, setpoint, wrench, rotor_speeds, monitor } = *record;
        Self { tick, state, setpoint, wrench: Some(wrench), rotor_speeds: Some(rotor_speeds), monitor }
    }
}

/// Joins the messages of a tick, which come by topic.
#[derive(Debug, Default)]
pub struct Joiner {
    waiting: BTreeMap<u64, Parts>,
    /// Newest tick of each topic: a topic never goes back.
    newest: [Option<u64>; TOPICS],
    /// Newest tick that nothing is waited for any more.
    settled: Option<u64>,
    /// Ticks of which a topic had no message.
    pub incomplete: u64,
}

/// Topics that are joined.
const TOPICS: usize = 4;

#[derive(Debug, Default)]
struct Parts {
    state: Option<State>,
    setpoint: Option<Setpoint>,
    wrench: Option<Wrench>,
    rotor_speeds: Option<RotorSpeeds>,
    monitor: Option<Monitor>,
}

/// A message of one topic.
#[derive(Clone, Copy, Debug)]
#[allow(clippy::large_enum_variant, reason = "it is handed on at once, and never kept")]
pub enum LoopMessage {
    /// Topic `state`.
    State(State),
    /// Topic `setpoint`.
    Setpoint(Setpoint),
    /// Topic `wrench`, with what topic `theorem` says of it.
    Wrench(Wrench, Option<Monitor>),
    /// Topic `rotor_speeds`.
    RotorSpeeds(RotorSpeeds),
}

/// Ticks for which a message may come later than the state of a newer tick: longer than a stage may stand still with it
/// where stages are started again. Each that waits is kept whole, some 4 KiB.
const STAGE_PATIENCE_TICKS: u64 = 500;
/// The same for any topic of a newer tick: a recorder that stood still between two of them finds the later ones ahead.
const PATIENCE_TICKS: u64 = 5_000;

impl Joiner {
    /// Takes a message in.
    pub fn take(&mut self, tick: u64, part: LoopMessage) {
        let topic = match part {
            LoopMessage::State(_) => 0,
            LoopMessage::Setpoint(_) => 1,
            LoopMessage::Wrench(..) => 2,
            LoopMessage::RotorSpeeds(_) => 3,
        };
        self.newest[topic] = self.newest[topic].max(Some(tick));
        if Some(tick) <= self.settled {
            return;
        }
        let parts = self.waiting.entry(tick).or_default();
        match part {
            LoopMessage::State(state) => parts.state = Some(state),
            LoopMessage::Setpoint(setpoint) => parts.setpoint = Some(setpoint),
            LoopMessage::Wrench(wrench, monitor) => (parts.wrench, parts.monitor) = (Some(wrench), monitor),
            LoopMessage::RotorSpeeds(speeds) => parts.rotor_speeds = Some(speeds),
        }
    }

    /// The next state for whose tick nothing more can come, in the order of the ticks; to be asked when all topics are
    /// drained, states first: what was sent before the newest of them is there then.
    pub fn settled(&mut self) -> Option<Joined> {
        let newest = self.newest.into_iter().max().flatten()?;
        let newest_state = self.newest[0].unwrap_or(0);
        while let Some((tick, parts)) = self.waiting.first_key_value() {
            let is_over = parts.there().iter().zip(self.newest).all(|(there, newest)| *there || newest > Some(*tick));
            if !is_over && tick + STAGE_PATIENCE_TICKS >= newest_state && tick + PATIENCE_TICKS >= newest {
                return None;
            }
            if let Some(joined) = self.next() {
                return Some(joined);
            }
        }
        None
    }

    /// As [`Self::settled`], when nothing more comes at all.
    pub fn rest(&mut self) -> Option<Joined> {
        while !self.waiting.is_empty() {
            if let Some(joined) = self.next() {
                return Some(joined);
            }
        }
        None
    }

    /// Takes the oldest tick off; none where it has no state.
    fn next(&mut self) -> Option<Joined> {
        let (tick, parts) = self.waiting.pop_first()?;
        self.settled = Some(tick);
        self.incomplete += u64::from(parts.there() != [true; TOPICS]);
        let Parts { state, setpoint, wrench, rotor_speeds, monitor } = parts;
        state.map(|state| Joined { tick, state, setpoint, wrench, rotor_speeds, monitor })
    }
}

impl Parts {
    const fn there(&self) -> [bool; TOPICS] {
        [self.state.is_some(), self.setpoint.is_some(), self.wrench.is_some(), self.rotor_speeds.is_some()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(joiner: &mut Joiner, tick: u64, topics: &str) {
        for topic in topics.chars() {
            joiner.take(
                tick,
                match topic {
                    's' => LoopMessage::State(State::default()),
                    'p' => LoopMessage::Setpoint(Setpoint::default()),
                    'w' => LoopMessage::Wrench(Wrench::default(), None),
                    _ => LoopMessage::RotorSpeeds(RotorSpeeds::default()),
                },
            );
        }
    }

    fn settled(joiner: &mut Joiner) -> Vec<u64> {
        std::iter::from_fn(|| joiner.settled()).map(|joined| joined.tick).collect()
    }

    #[test]
    fn a_state_that_no_stage_answered_is_there_in_its_place() {
        let mut joiner = Joiner::default();
        [(7, "spwr"), (8, "sp"), (9, "s")].into_iter().for_each(|(tick, topics)| take(&mut joiner, tick, topics));
        assert_eq!(settled(&mut joiner), [7], "something may still come");
        take(&mut joiner, 10, "spwr");
        assert_eq!(settled(&mut joiner), [8, 9, 10], "every topic has gone on");
        assert_eq!(joiner.incomplete, 2);
        take(&mut joiner, 9, "w");
        assert_eq!((settled(&mut joiner), joiner.incomplete), (vec![], 2), "too late");
    }

    #[test]
    fn a_stage_that_is_silent_is_not_waited_for_for_ever() {
        let mut joiner = Joiner::default();
        (0..=STAGE_PATIENCE_TICKS + 2).for_each(|tick| take(&mut joiner, tick, "sp"));
        assert_eq!(settled(&mut joiner), [0, 1]);
        assert_eq!(std::iter::from_fn(|| joiner.rest()).count() as u64, STAGE_PATIENCE_TICKS + 1);
        assert_eq!(joiner.incomplete, STAGE_PATIENCE_TICKS + 3);
    }

    #[test]
    fn topics_that_are_ahead_of_the_states_wait_for_them() {
        let mut joiner = Joiner::default();
        take(&mut joiner, 0, "spwr");
        // A recorder that stood still between the states and the others.
        (1..PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "pwr"));
        assert_eq!(settled(&mut joiner), [0]);
        (1..PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "s"));
        assert_eq!((settled(&mut joiner).len() as u64, joiner.incomplete), (PATIENCE_TICKS - 1, 0));
        // A plant that is silent for good.
        (PATIENCE_TICKS..3 * PATIENCE_TICKS).for_each(|tick| take(&mut joiner, tick, "w"));
        assert!(settled(&mut joiner).is_empty());
        assert!(joiner.waiting.len() as u64 <= PATIENCE_TICKS + 1, "{}", joiner.waiting.len());
    }

    #[test]
    fn a_tick_without_a_state_has_no_row_and_holds_nothing_up() {
        let mut joiner = Joiner::default();
        [(3, "wr"), (4, "spwr")].into_iter().for_each(|(tick, topics)| take(&mut joiner, tick, topics));
        assert_eq!((settled(&mut joiner), joiner.incomplete), (vec![4], 1));
    }
}
