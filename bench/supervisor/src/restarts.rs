//! Restarts of failed roles: how often and when.

use std::time::{Duration, Instant};

/// Most restarts of a role within [`WITHIN`]; one more ends the flight.
pub(super) const MAX_RESTARTS: usize = 5;
pub(super) const WITHIN: Duration = Duration::from_secs(10);
/// Shortest time between two starts of a role: a process that fails at once does not keep a processor busy.
const MIN_INTERVAL: Duration = Duration::from_millis(50);

/// When a role may be restarted.
#[derive(Clone, Debug)]
pub(super) struct RestartLimit {
    started: Instant,
    /// Restarts within [`WITHIN`].
    restarts: Vec<Instant>,
}

impl RestartLimit {
    pub(super) const fn new(started: Instant) -> Self {
        Self {
            started,
            restarts: Vec::new(),
        }
    }

    /// When to restart a role that has failed; `None` if it has failed too often.
    pub(super) fn due(&mut self, now: Instant) -> Option<Instant> {
        self.restarts
            .retain(|then| now.duration_since(*then) < WITHIN);
        (self.restarts.len() < MAX_RESTARTS).then(|| now.max(self.started + MIN_INTERVAL))
    }

    pub(super) fn restarted(&mut self, now: Instant) {
        self.started = now;
        self.restarts.push(now);
    }

    pub(super) fn is_restarted(&self) -> bool {
        !self.restarts.is_empty()
    }

    /// Time since the last start.
    pub(super) fn age(&self) -> Duration {
        self.started.elapsed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// When a role is restarted that fails each time after `lifetime`.
    fn restarts(lifetime_ms: u64, times: usize) -> Vec<Option<u128>> {
        let (begin, lifetime) = (Instant::now(), Duration::from_millis(lifetime_ms));
        let (mut limit, mut failed) = (RestartLimit::new(begin), begin + lifetime);
        let mut started = Vec::new();
        for _ in 0..times {
            let due = limit.due(failed);
            started.push(due.map(|due| (due - begin).as_millis()));
            let Some(due) = due else { break };
            limit.restarted(due);
            failed = due + lifetime;
        }
        started
    }

    #[test]
    fn five_restarts_in_ten_seconds_and_no_sixth() {
        let at_once = [Some(50), Some(100), Some(150), Some(200), Some(250), None];
        assert_eq!(restarts(0, 9), at_once);
        assert_eq!(restarts(1999, 9).len(), 6, "the sixth comes too early");
        assert_eq!(
            restarts(2000, 100).len(),
            100,
            "a failure every two seconds is tolerated"
        );
    }

    #[test]
    fn a_role_that_ran_longer_is_restarted_at_once() {
        let begin = Instant::now();
        let mut limit = RestartLimit::new(begin);
        let failed = begin + Duration::from_secs(3);
        assert_eq!(limit.due(failed), Some(failed));
        assert!(!limit.is_restarted());
        limit.restarted(failed);
        assert!(limit.is_restarted());
        assert_eq!(limit.due(failed), Some(failed + MIN_INTERVAL));
    }
}
