//! How a flight's processes ended, and what that means for its report.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

use model::role::Role;
use role::stop::asks_for_the_end;
use rustix::fs::statvfs;

use crate::fly::launcher::ENDING;
use crate::output::say;
use failure::{FAILED, Failure, GATE, INTERRUPTED};
use report::schema::Report;
use report::status::FlightStatus;
use report::verdict::break_off;

/// How a flight's processes ended.
#[derive(Default)]
pub(super) struct Ended {
    /// The process that failed.
    pub(super) died: Option<Left>,
    /// The process that a signal ended which the launcher has not sent.
    pub(super) stopped: Option<Left>,
    /// Whether a signal has asked the launcher for the end.
    pub(super) interrupted: bool,
    /// Whether the plant has taken off.
    pub(super) flown: bool,
}

/// A process that has ended.
pub(super) struct Left {
    pub(super) role: Role,
    pub(super) status: ExitStatus,
    /// Whether a signal had asked the launcher for the end by then.
    pub(super) interrupted: bool,
    /// Whether the launcher has killed it, because it did not end with the flight.
    pub(super) hung: bool,
}

impl Ended {
    /// Takes in that a process has left: one that was not told to, if not `told`; before the flight began, if `early`.
    pub(super) fn take(&mut self, left: Left, told: bool, early: bool) {
        if left.was_interrupted() {
            if !told {
                self.stopped.get_or_insert(left);
            }
        } else if !left.is_in_order() || early && !told {
            // A recorder that ends on another one's failure may be seen before that one.
            if self.died.as_ref().is_none_or(|known| known.role == Role::Record) {
                self.died = Some(left);
            }
        }
    }

    /// Whether the other processes have no reason to go on.
    pub(super) const fn is_over(&self) -> bool {
        self.interrupted || self.died.is_some() || self.stopped.is_some()
    }

    /// Puts into the report what the recorder could not know: that a process died, or that its own last word is
    /// missing. Says whether it did.
    pub(super) fn correct(&self, report: &mut Report) -> bool {
        let (status, ending) = match &self.died {
            Some(died) => (FlightStatus::Aborted, died.how()),
            None if !report.run.in_flight => return false,
            None if self.is_over() => (FlightStatus::Interrupted, "interrupted".into()),
            None => (FlightStatus::Aborted, "the recorder ended too early".into()),
        };
        break_off(report, status, ending);
        true
    }

    /// Why there is no report.
    pub(super) fn failure(&self, directory: &Path) -> Failure {
        self.died.iter().chain(&self.stopped).for_each(|left| say(&left.words(directory)));
        let when = if self.flown { "the flight had a report" } else { "the flight began" };
        if let Some(stopped) = &self.stopped {
            let what = format!("the {} was interrupted before {when}", process(stopped.role));
            return Failure::new(INTERRUPTED, what);
        }
        match &self.died {
            // What a process says of the end of another one, after a signal, is no news.
            Some(died) if !died.interrupted => {
                let code = died.status.code().and_then(|code| u8::try_from(code).ok()).filter(|code| *code != 0);
                let what = format!("the {} ended before {when}", process(died.role));
                Failure::new(code.unwrap_or(FAILED), what)
            }
            _ if self.interrupted => Failure::new(INTERRUPTED, format!("interrupted before {when}")),
            _ => Failure::failed("the processes ended without a report"),
        }
    }
}

impl Left {
    /// Whether it did what it should; the recorder's exit code is the flight's verdict.
    fn is_in_order(&self) -> bool {
        self.status.success() || (self.role == Role::Record && self.status.code() == Some(i32::from(GATE)))
    }

    /// Whether a signal asked for its end, be it before the process could handle it.
    fn was_interrupted(&self) -> bool {
        self.status.code() == Some(i32::from(INTERRUPTED)) || self.status.signal().is_some_and(asks_for_the_end)
    }

    /// What the process said last.
    pub(super) fn words(&self, directory: &Path) -> String {
        let mut said = fs::read_to_string(log_path(directory, self.role)).unwrap_or_default();
        if said.is_empty() && is_full(directory) {
            said = format!("{}: the disk is full, and had no room for what the process said\n", directory.display());
        }
        format!("{}: {}\n{said}", process(self.role), self.status)
    }

    /// How it ended, in words.
    fn how(&self) -> String {
        let process = process(self.role);
        if self.hung {
            format!("the {process} did not end within {} s of the flight and was killed", ENDING.as_secs())
        } else {
            format!("the {process} died: {}", self.status)
        }
    }
}

/// What the process of a role is called.
pub(super) fn process(role: Role) -> String {
    if role == Role::Record { "recorder".into() } else { format!("{role} process") }
}

fn is_full(directory: &Path) -> bool {
    const A_WORD_BYTES: u64 = 16 << 10;
    statvfs(directory).is_ok_and(|disk| disk.f_bavail * disk.f_frsize < A_WORD_BYTES)
}

/// Where a process' standard error goes.
pub(super) fn log_path(directory: &Path, role: Role) -> PathBuf {
    directory.join(format!("{role}.log"))
}

#[cfg(test)]
mod tests {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

    use super::*;

    fn left(role: Role, raw: i32) -> Left {
        Left { role, status: ExitStatus::from_raw(raw), interrupted: false, hung: false }
    }

    /// A wait status: an exit code stands in the second byte, a signal in the first.
    const fn code(code: i32) -> i32 {
        code << 8
    }

    #[test]
    fn whoever_ends_before_the_flight_ends_the_wait() {
        let after = |role, raw, early| {
            let mut ended = Ended::default();
            ended.take(left(role, raw), false, early);
            (ended.is_over(), ended.failure(Path::new("/nonexistent")).code)
        };
        assert_eq!(after(Role::Outer, code(0), true), (true, FAILED));
        assert_eq!(after(Role::Outer, code(130), true), (true, INTERRUPTED));
        assert_eq!(after(Role::Outer, code(5), true), (true, 5));
        assert_eq!(after(Role::Outer, 9, true), (true, FAILED));
        for signal in [SIGTERM, SIGHUP, SIGINT, SIGQUIT] {
            assert_eq!(after(Role::Plant, signal, true), (true, INTERRUPTED), "signal {signal}");
        }
        assert_eq!(after(Role::Outer, code(0), false), (false, FAILED));
        assert_eq!(after(Role::Record, code(3), false), (false, FAILED));
        assert_eq!(after(Role::Mixer, code(3), false), (true, 3));
    }

    #[test]
    fn who_failed_first_is_named_and_a_recorder_that_follows_is_not() {
        let mut ended = Ended::default();
        ended.take(left(Role::Record, code(1)), false, false);
        ended.take(left(Role::Inner, 9), false, false);
        ended.take(left(Role::Mixer, code(1)), true, false);
        ended.take(left(Role::Plant, code(130)), true, false);
        assert_eq!(ended.died.map(|left| left.role), Some(Role::Inner));
        assert!(ended.stopped.is_none(), "it was told to end");
    }

    #[test]
    fn an_interruption_is_one_whatever_the_processes_make_of_it() {
        let mut ended = Ended { interrupted: true, ..Ended::default() };
        ended.take(Left { interrupted: true, ..left(Role::Outer, code(1)) }, true, true);
        assert_eq!(ended.failure(Path::new("/nonexistent")).code, INTERRUPTED);
    }
}
