//! Compares the messages of a log with those that follow from others, in their order.

use std::collections::VecDeque;

use flight_log::codec::Logged;
use flight_log::entry::LogEntry;
use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::header::Message;

use crate::comparison::ReplayComparison;

/// Messages that may wait for their counterparts. In a sound log, both come at one position.
const MOST_WAITING: usize = 4096;

#[derive(Clone, Debug, Default)]
pub struct Expected<C> {
    recorded: VecDeque<Message<C>>,
    following: VecDeque<Message<C>>,
}

impl<C: Logged> Expected<C> {
    /// Takes a message of the log.
    pub fn recorded(&mut self, message: &Message<C>, comparison: &mut ReplayComparison) {
        self.recorded.push_back(*message);
        self.compare(MOST_WAITING, comparison);
    }

    /// Takes a message that follows from others.
    pub fn follows(&mut self, message: &Message<C>, comparison: &mut ReplayComparison) {
        self.following.push_back(*message);
        self.compare(MOST_WAITING, comparison);
    }

    /// No message comes any more.
    pub fn finish(&mut self, comparison: &mut ReplayComparison) {
        self.compare(0, comparison);
    }

    fn compare(&mut self, most_waiting: usize, comparison: &mut ReplayComparison) {
        while let (Some(recorded), Some(following)) =
            (self.recorded.front(), self.following.front())
        {
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
            self.recorded.drain(..1);
            self.following.drain(..1);
        }
        if self.recorded.len() > most_waiting {
            let extra = self.recorded.drain(..);
            extra.for_each(|it| comparison.lacks::<C>(it.envelope.tick, "message"));
        }
        if self.following.len() > most_waiting {
            let missing = self.following.drain(..);
            missing.for_each(|it| comparison.has_more::<C>(it.envelope.tick));
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
    pub fn recorded(&mut self, entry: &LogEntry, comparison: &mut ReplayComparison) {
        match entry {
            LogEntry::Setpoint(message) => self.setpoints.recorded(message, comparison),
            LogEntry::Wrench(message) => self.wrenches.recorded(message, comparison),
            LogEntry::RotorSpeeds(message) => self.rotor_speeds.recorded(message, comparison),
            _ => {}
        }
    }

    pub fn follows(&mut self, entry: &LogEntry, comparison: &mut ReplayComparison) {
        match entry {
            LogEntry::Setpoint(message) => self.setpoints.follows(message, comparison),
            LogEntry::Wrench(message) => self.wrenches.follows(message, comparison),
            LogEntry::RotorSpeeds(message) => self.rotor_speeds.follows(message, comparison),
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
            for tick in recorded {
                expected.recorded(&wrench(*tick), &mut comparison);
            }
            for tick in following {
                expected.follows(&wrench(*tick), &mut comparison);
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
