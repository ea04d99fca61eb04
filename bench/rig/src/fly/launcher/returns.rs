//! How a role comes back whose process has died in flight.

use std::time::Instant;

use model::boards::Run;
use model::role::{ROLES, Role};
use report::deaths::{Noted, Way};
use wire::clock::now_ns;

use super::Launcher;
use crate::fly::ending::{Ended, Left};
use crate::fly::restarts;
use crate::output::say;
use failure::Failure;

impl Launcher {
    /// Notes that a process has died in the air, and has its role started again; gives it back where it is not.
    pub(super) fn fallen(&mut self, mut left: Left, run: &Run, ended: &mut Ended) -> Option<Left> {
        let epoch = self.status_of(left.role, left.pid).map_or(0, |status| status.epoch);
        ended.grid = Some(run.pace());
        let (role, how) = (left.role.name().into(), left.cause());
        ended.noted.push(Noted { role, epoch, how, noticed_ns: now_ns(), way: Way::default() });
        if !self.restarts_roles() {
            return Some(left);
        }
        if left.role == Role::Plant {
            left.not_again = Some("a plant cannot be started again in flight".into());
            return Some(left);
        }
        let Some(due) = self.restarts[left.role as usize].due(Instant::now()) else {
            let (most, s) = (restarts::MOST, restarts::WITHIN.as_secs());
            left.not_again = Some(format!("it has been started again {most} times within {s} s, which is the most"));
            return Some(left);
        };
        // What it held is free when its successor comes.
        self.wire.remove_leavings();
        ended.noted.last_mut().into_iter().for_each(|noted| noted.way.cleaned_ns = now_ns());
        self.due.push((left, due));
        None
    }

    /// Starts the roles that are due, or has their spares go on.
    pub(super) fn start_again(&mut self, noted: &mut [Noted]) -> Result<(), Failure> {
        let now = Instant::now();
        let (due, later): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.due).into_iter().partition(|(_, due)| *due <= now);
        self.due = later;
        for (left, _) in due {
            let role = left.role;
            if role == Role::Record
                && let Err(failure) = self.recordings.begin_another()
            {
                say(&format!("{}; the flight goes on without a recorder: {failure}\n", left.how("")));
                continue;
            }
            let spare = self.spares.take(role);
            let is_spare = spare.is_some();
            let child = spare.map_or_else(|| self.starter.start(role, self.recordings.newest()), Ok)?;
            self.restarts[role as usize].started_again(now);
            if let Some(noted) = noted.iter_mut().rfind(|noted| noted.role == role.name()) {
                (noted.way.pid, noted.way.is_spare) = (child.id(), is_spare);
            }
            if !is_spare {
                self.ends.watch(&child);
            }
            self.children.push((role, child));
            self.spares.started(role, now);
            self.status_line.clear();
            let by = if is_spare { ": its spare takes over" } else { "" };
            say(&format!("{}; it is started again{by}\n", left.how("")));
        }
        Ok(())
    }

    /// Takes in how those came back that fly by now.
    pub(super) fn follow_returns(&self, noted: &mut [Noted]) {
        for noted in noted.iter_mut().filter(|noted| noted.way.pid != 0 && noted.way.arrival.armed_ns == 0) {
            let role = ROLES.into_iter().find(|role| role.name() == noted.role);
            if let Some(status) = role.and_then(|role| self.status_of(role, noted.way.pid)) {
                noted.way.arrival = status.arrival;
            }
        }
    }
}
