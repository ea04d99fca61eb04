//! Compares the messages of a log with those that follow from others, in their order.

use std::collections::VecDeque;

use flight_log::codec::Logged;
use flight_log::entry::EntryRef;
use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::header::Message;

use crate::comparison::ReplayComparison;

/// Messages that may wait for their counterparts. In a sound log, both come at one position.
const MOST_WAITING: usize = 4096;

/// Where a message comes from.
#[derive(Clone, Copy, Debug)]
pub enum Origin {
    /// The log has it.
    Log,
    /// It follows from others.
    Others,
}

#[derive(Clone, Debug, Default)]
pub struct Expected<C> {
    /// Messages without their counterparts, by [`Origin`].
    waiting: [VecDeque<Message<C>>; 2],
}

impl<C: Logged> Expected<C> {
    pub fn take(
        &mut self,
        origin: Origin,
        message: &Message<C>,
        comparison: &mut ReplayComparison,
    ) {
        self.waiting[origin as usize].push_back(*message);
        self.compare(MOST_WAITING, comparison);
    }

    /// No message comes any more.
    pub fn finish(&mut self, comparison: &mut ReplayComparison) {
        self.compare(0, comparison);
    }

    fn compare(&mut self, most_waiting: usize, comparison: &mut ReplayComparison) {
        while let [Some(recorded), Some(following)] = self.waiting.each_ref().map(VecDeque::front) {
            let tick = recorded.envelope.tick;
            comparison.compare(tick, &recorded.content, &following.content);
            if recorded.envelope != following.envelope {
                let headers = [recorded, following].map(|it| {
                    let header = &it.envelope;
                    format!("tick {}, number {}", header.tick, header.seq)
                });
                comparison.differs::<C>(tick, "envelope", headers);
            }
            // `pop_front` would copy them.
            self.waiting.iter_mut().for_each(|it| drop(it.drain(..1)));
        }
        let words = [["published", "nothing"], ["missing", "published"]];
        for (waiting, words) in self.waiting.iter_mut().zip(words) {
            if waiting.len() > most_waiting {
                let ticks = waiting.drain(..).map(|it| it.envelope.tick);
                ticks.for_each(|tick| {
                    comparison.differs::<C>(tick, "message", words.map(str::to_owned));
                });
            }
        }
    }
}

/// Messages of the flight, of the channels whose commands were taken.
#[derive(Clone, Debug, Default)]
pub struct Flown {
    setpoints: Expected<Setpoint>,
    wrenches: Expected<Wrench>,
    rotor_speeds: Expected<RotorSpeeds>,
}

impl Flown {
    pub fn take(&mut self, origin: Origin, entry: EntryRef<'_>, comparison: &mut ReplayComparison) {
        match entry {
            EntryRef::Setpoint(message) => self.setpoints.take(origin, message, comparison),
            EntryRef::Wrench(message) => self.wrenches.take(origin, message, comparison),
            EntryRef::RotorSpeeds(message) => self.rotor_speeds.take(origin, message, comparison),
            _ => {}
        }
    }

    pub fn finish(&mut self, comparison: &mut ReplayComparison) {
        self.setpoints.finish(comparison);
        self.wrenches.finish(comparison);
        self.rotor_speeds.finish(comparison);
    }
}

#[cfg(test)]
mod tests {
    use messages::role::Channel;
    use messages::telemetry::Signals;

    use super::*;

    #[test]
    fn a_message_without_a_counterpart_or_with_another_one_is_a_difference_at_its_tick() {
        let wrench = |tick| Message::of_tick(tick, Wrench::default());
        let first = |recorded: &[u64], following: &[u64]| {
            let mut comparison = ReplayComparison::from(0, Channel::A, Signals::default());
            let mut expected = Expected::default();
            for (origin, ticks) in [(Origin::Log, recorded), (Origin::Others, following)] {
                for tick in ticks {
                    expected.take(origin, &wrench(*tick), &mut comparison);
                }
            }
            expected.finish(&mut comparison);
            comparison.first.map(|it| (it.tick, it.recorded))
        };
        let found = |tick, what: &str| Some((tick, what.to_owned()));
        assert_eq!(first(&[1, 2], &[1, 2]), None);
        assert_eq!(first(&[1, 2], &[1]), found(2, "published"));
        assert_eq!(first(&[1], &[1, 3]), found(3, "missing"));
        assert_eq!(first(&[1, 3], &[1, 2]), found(3, "tick 3, number 0"));
    }
}
