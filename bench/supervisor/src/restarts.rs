//! Restarts of failed roles: how often and when, and the hot standbys that take over.

use std::io::Write as _;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use host::sampler::Look;
use ipc::Wire;
use messages::checks::{Check, is_on};
use messages::role::{ROLES, Role};

use crate::child_process::{ChildWatch, Spawner, kill, kill_and_reap, title};
use errors::output::say;

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
        (self.restarts.len() < MAX_RESTARTS || !is_on(Check::RestartLimit))
            .then(|| now.max(self.started + MIN_INTERVAL))
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

/// The roles with a hot standby. A standby recorder would need a directory that does not exist before the failure.
const STANDBY_ROLES: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];
/// Shortest time between the starts of two standbys: together they would disturb the flight.
const STANDBY_INTERVAL: Duration = Duration::from_millis(100);
/// Time from the end of a standby that was killed to the start of the next one.
const REPLACEMENT_DELAY: Duration = Duration::from_secs(1);

/// The hot standbys of a flight: one process for each stage, which waits to take its place.
pub(super) struct Standbys {
    waiting: Vec<(Role, Child)>,
    /// Standbys that were dismissed or killed, and not reaped.
    ending: Vec<Child>,
    /// From when on a role may have a standby; `None` after one has failed.
    allowed_from: [Option<Instant>; ROLES.len()],
    next_start: Instant,
}

impl Standbys {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            waiting: Vec::new(),
            ending: Vec::new(),
            allowed_from: ROLES.map(|_| Some(now)),
            next_start: now,
        }
    }

    /// Delays the standby of a role whose process has just been started.
    pub(super) fn delay(&mut self, role: Role, now: Instant) {
        let from = &mut self.allowed_from[role as usize];
        *from = from.map(|from| from.max(now + MIN_INTERVAL));
    }

    /// Starts one missing standby.
    pub(super) fn replenish(&mut self, spawner: &Spawner, children: &mut ChildWatch, now: Instant) {
        let is_missing = |role: &Role| {
            self.allowed_from[*role as usize].is_some_and(|from| from <= now)
                && !self.waiting.iter().any(|(known, _)| known == role)
        };
        let missing = STANDBY_ROLES.into_iter().find(is_missing);
        let Some(role) = missing.filter(|_| self.next_start <= now) else {
            return;
        };
        self.next_start = now + STANDBY_INTERVAL;
        match spawner.start_standby(role) {
            Ok(child) => {
                children.watch(&child);
                self.waiting.push((role, child));
            }
            Err(failure) => {
                self.allowed_from[role as usize] = None;
                say(&format!("the flight goes on without one: {failure}\n"));
            }
        }
    }

    /// Activates the standby of a role; `None` if there is none that can take over.
    pub(super) fn activate(&mut self, role: Role) -> Option<Child> {
        let place = self.waiting.iter().position(|(known, _)| *known == role)?;
        let (_, mut child) = self.waiting.swap_remove(place);
        let input = child.stdin.take().filter(|_| !is_stopped(&child));
        if input.is_some_and(|mut input| input.write_all(b"\n").is_ok()) {
            return Some(child);
        }
        kill(&mut child);
        self.ending.push(child);
        None
    }

    /// Reaps standbys that have ended. One that was killed is replaced later; one that failed would fail again.
    pub(super) fn reap(&mut self, children: &mut ChildWatch, wire: &Wire, now: Instant) {
        let mut reap = |child: &mut Child| -> Option<ExitStatus> { children.reap(child).ok()? };
        let mut ended = Vec::new();
        self.waiting.retain_mut(|(role, child)| {
            let status = reap(child);
            ended.extend(status.map(|status| (*role, status)));
            status.is_none()
        });
        let mut is_killed = ended.iter().any(|(_, status)| status.code().is_none());
        self.ending.retain_mut(|child| {
            let status = reap(child);
            is_killed |= status.is_some_and(|status| status.code().is_none());
            status.is_none()
        });
        if is_killed {
            wire.remove_dead();
        }
        for (role, status) in ended {
            let has_failed = status.code().is_some_and(|code| code != 0);
            self.allowed_from[role as usize] = (!has_failed).then(|| now + REPLACEMENT_DELAY);
            if has_failed {
                say(&format!(
                    "the {} no longer has a hot standby: it ended with {status}; see {role}.log\n",
                    title(role)
                ));
            }
        }
    }

    /// Asks all standbys to end, by closing their standard input, and starts no more.
    pub(super) fn dismiss(&mut self) {
        self.allowed_from = ROLES.map(|_| None);
        for (_, mut child) in self.waiting.drain(..) {
            drop(child.stdin.take());
            // A stopped process does not notice.
            if is_stopped(&child) {
                kill(&mut child);
            }
            self.ending.push(child);
        }
    }

    /// Dismisses all standbys, and kills those that have not ended after `timeout`.
    pub(super) fn end(&mut self, children: &mut ChildWatch, wire: &Wire, timeout: Duration) {
        self.dismiss();
        let begun = Instant::now();
        while begun.elapsed() < timeout && !self.ending.is_empty() {
            self.reap(children, wire, Instant::now());
            std::thread::sleep(Duration::from_millis(1));
        }
        self.ending
            .drain(..)
            .for_each(|mut child| kill_and_reap(&mut child));
    }
}

/// Whether a signal has stopped a process, or it cannot be seen.
fn is_stopped(child: &Child) -> bool {
    Look::at(u64::from(child.id())).is_none_or(Look::is_stopped)
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
