//! When a role that has died is started again, and when no more.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use model::guards::{Guard, is_on};

/// Restarts of a role ...
pub(super) const MOST: usize = 5;
/// ... in this time: one more ends the flight.
pub(super) const WITHIN: Duration = Duration::from_secs(10);
/// From one start of a role to the next at the least: a process that dies at once does not keep a processor busy.
pub(super) const APART: Duration = Duration::from_millis(50);

/// The starts of a role.
#[derive(Clone, Debug)]
pub(super) struct Restarts {
    started: Instant,
    /// Those after the first, of the last [`WITHIN`].
    again: VecDeque<Instant>,
}

impl Restarts {
    /// Of a role that has been started.
    pub(super) const fn new(started: Instant) -> Self {
        Self { started, again: VecDeque::new() }
    }

    /// When to start the role that was found dead; nothing where it has died too often.
    pub(super) fn due(&mut self, now: Instant) -> Option<Instant> {
        while self.again.front().is_some_and(|then| now.duration_since(*then) >= WITHIN) {
            self.again.pop_front();
        }
        (self.again.len() < MOST || !is_on(Guard::RestartLimit)).then(|| now.max(self.started + APART))
    }

    /// Takes in that it was started again.
    pub(super) fn started_again(&mut self, now: Instant) {
        self.started = now;
        self.again.push_back(now);
    }

    /// Whether the process is not the first one.
    pub(super) fn is_again(&self) -> bool {
        !self.again.is_empty()
    }

    /// How long ago the last start was.
    pub(super) fn age(&self) -> Duration {
        self.started.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A role that dies each time `lives` after its start: when it was started again.
    fn dies(lives: Duration, times: usize) -> Vec<Option<Duration>> {
        let begin = Instant::now();
        let (mut restarts, mut died) = (Restarts::new(begin), begin + lives);
        let mut started = Vec::new();
        for _ in 0..times {
            let due = restarts.due(died);
            started.push(due.map(|due| due - begin));
            let Some(due) = due else { break };
            restarts.started_again(due);
            died = due + lives;
        }
        started
    }

    #[test]
    fn five_restarts_in_ten_seconds_and_no_sixth() {
        let ms = Duration::from_millis;
        let at_once = dies(ms(0), 9);
        assert_eq!(at_once, [Some(ms(50)), Some(ms(100)), Some(ms(150)), Some(ms(200)), Some(ms(250)), None]);
        assert_eq!(dies(ms(1999), 9).iter().filter(|due| due.is_some()).count(), 5, "the sixth comes too early");
        assert_eq!(dies(ms(2000), 100).len(), 100, "a death every two seconds is borne for ever");
    }

    #[test]
    fn whoever_lived_longer_is_started_at_once() {
        let begin = Instant::now();
        let mut restarts = Restarts::new(begin);
        let died = begin + Duration::from_secs(3);
        assert_eq!(restarts.due(died), Some(died));
        assert!(!restarts.is_again());
        restarts.started_again(died);
        assert!(restarts.is_again());
        assert_eq!(restarts.due(died), Some(died + APART));
    }
}
