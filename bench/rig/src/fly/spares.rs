//! The spares of a flight: a process beside each stage, which waits to take its place.

use std::io::Write as _;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use machine::sampler::Look;
use model::role::{ROLES, Role};
use rustix::process::{Signal, kill_process_group};

use crate::fly::ending::process;
use crate::fly::ends::{Ends, number_of};
use crate::fly::restarts::APART;
use crate::fly::starter::Starter;
use crate::output::say;
use wire::Wire;

/// The roles that have spares. A second recorder writes into a directory that there is not before the first one's death.
const ROLES_WITH_SPARES: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];
/// From one start of a spare to the next at the least, whatever their roles: they do not start all at once beside a
/// flight.
const ONE_BY_ONE: Duration = Duration::from_millis(100);
/// After a spare was killed while it waited, until its role has another one.
const AGAIN: Duration = Duration::from_secs(1);

/// The processes that wait.
pub(super) struct Spares {
    waiting: Vec<(Role, Child)>,
    /// Those that were told to end, or killed.
    ending: Vec<Child>,
    /// When a role may have a spare; never again where one has ended by itself.
    from: [Option<Instant>; ROLES.len()],
    next: Instant,
}

impl Spares {
    pub(super) fn new(now: Instant) -> Self {
        Self { waiting: Vec::new(), ending: Vec::new(), from: ROLES.map(|_| Some(now)), next: now }
    }

    /// Takes in that a process of a role was started.
    pub(super) fn started(&mut self, role: Role, now: Instant) {
        let from = &mut self.from[role as usize];
        *from = from.map(|from| from.max(now + APART));
    }

    /// Starts a spare that is missing, one at the most.
    pub(super) fn keep(&mut self, starter: &Starter, ends: &mut Ends, now: Instant) {
        let lacks = |role: &Role| {
            let may = self.from[*role as usize].is_some_and(|from| from <= now);
            may && !self.waiting.iter().any(|(known, _)| known == role)
        };
        let Some(role) = ROLES_WITH_SPARES.into_iter().find(lacks).filter(|_| self.next <= now) else { return };
        self.next = now + ONE_BY_ONE;
        match starter.start_spare(role) {
            Ok(child) => {
                ends.watch(&child);
                self.waiting.push((role, child));
            }
            Err(failure) => {
                self.from[role as usize] = None;
                say(&format!("the flight goes on without one: {failure}\n"));
            }
        }
    }

    /// The spare of a role, told to go on; nothing where there is none that can.
    pub(super) fn take(&mut self, role: Role) -> Option<Child> {
        let place = self.waiting.iter().position(|(known, _)| *known == role)?;
        let (_, mut child) = self.waiting.swap_remove(place);
        let door = child.stdin.take().filter(|_| !is_stopped(&child));
        if door.is_some_and(|mut door| door.write_all(b"\n").is_ok()) {
            return Some(child);
        }
        // Only a process that has ended already resists.
        let _ = child.kill();
        self.ending.push(child);
        None
    }

    /// Reaps those that have ended: a spare that was killed has a successor.
    pub(super) fn reap(&mut self, ends: &mut Ends, wire: &Wire, now: Instant) {
        let mut ended = Vec::new();
        self.waiting.retain_mut(|(role, child)| {
            let status = has_ended(child, ends);
            ended.extend(status.map(|status| (*role, status)));
            status.is_none()
        });
        let mut is_killed = ended.iter().any(|(_, status)| status.code().is_none());
        self.ending.retain_mut(|child| {
            let status = has_ended(child, ends);
            is_killed |= status.is_some_and(|status| status.code().is_none());
            status.is_none()
        });
        if is_killed {
            wire.remove_leavings();
        }
        for (role, status) in ended {
            // One that a signal has ended could have waited on; one that has failed fails again.
            let is_killed = status.code().is_none_or(|code| code == 0);
            self.from[role as usize] = is_killed.then(|| now + AGAIN);
            if !is_killed {
                let process = process(role);
                say(&format!("the {process} has no spare any more: it ended, {status}; {role}.log says why\n"));
            }
        }
    }

    /// Tells all to end, and starts no more: the end of their standard input is theirs.
    pub(super) fn dismiss(&mut self) {
        self.from = ROLES.map(|_| None);
        self.ending.extend(self.waiting.drain(..).map(|(_, mut child)| {
            drop(child.stdin.take());
            // One that is stopped hears of no end.
            if is_stopped(&child) {
                let _ = child.kill();
            }
            child
        }));
    }

    /// Waits until all have ended that were told to, or kills them after a time.
    pub(super) fn end(&mut self, ends: &mut Ends, wire: &Wire, patience: Duration) {
        self.dismiss();
        let begun = Instant::now();
        while begun.elapsed() < patience && !self.ending.is_empty() {
            self.reap(ends, wire, Instant::now());
            std::thread::sleep(Duration::from_millis(1));
        }
        for mut child in self.ending.drain(..) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Whether a signal has stopped a process, or it cannot be seen.
fn is_stopped(child: &Child) -> bool {
    Look::at(u64::from(child.id())).is_none_or(Look::is_stopped)
}

/// How a process has ended, with what code of its law has started; nothing while it lives.
fn has_ended(child: &mut Child, ends: &mut Ends) -> Option<ExitStatus> {
    let status = child.try_wait().ok().flatten()?;
    ends.forget(child.id());
    let _ = number_of(child).map(|group| kill_process_group(group, Signal::KILL));
    Some(status)
}
