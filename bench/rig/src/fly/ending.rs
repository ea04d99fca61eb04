//! How a flight's processes ended, and what that means for its report.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

use model::grid::Pace;
use model::role::{ROLES, Role, STAGES};
use role::stop::asks_for_the_end;
use rustix::fs::statvfs;

use crate::fly::launcher::{ENDING, LANDING};
use crate::output::say;
use failure::{FAILED, Failure, GATE, INTERRUPTED, harmless};
use report::deaths::{self, Noted};
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
    /// Roles that the launcher has killed, because they did not end when they were told to.
    pub(super) killed: Vec<Role>,
    /// Roles that were there when the plant had closed the run.
    pub(super) outlasted: Vec<Role>,
    /// Processes that died in the air.
    pub(super) noted: Vec<Noted>,
    /// What moved the ticks on in which they did.
    pub(super) grid: Option<Pace>,
}

/// A process that has ended.
pub(super) struct Left {
    pub(super) role: Role,
    pub(super) pid: u32,
    pub(super) status: ExitStatus,
    /// Whether a signal had asked the launcher for the end by then.
    pub(super) interrupted: bool,
    /// Why the launcher has killed it, where it has.
    pub(super) killed: Option<Killed>,
    /// Why it is not started again, where roles are.
    pub(super) not_again: Option<String>,
}

/// Why a launcher kills a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Killed {
    /// Its heartbeat stood still in flight.
    Hung,
    /// It did not end with the flight.
    AfterFlight,
    /// A fault of this tick wanted it.
    ByFault(u64),
}

impl Ended {
    /// Takes in that a process has left: one that was not told to, if not `told`; before the plant has closed the run, if
    /// `early`. An exit code of 0 is no reason to: a law's code may have said it.
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
    pub(super) fn correct(&self, report: &mut Report, directory: &Path) -> bool {
        let (status, ending) = match &self.died {
            Some(died) => {
                report.run.last_words = died.last_words(directory);
                (FlightStatus::Aborted, died.how(&flying(report, died.role)))
            }
            None if !report.run.in_flight => match self.unlanded(report).filter(|_| !self.is_over()) {
                Some(role) => {
                    let process = process(role) + &flying(report, role);
                    (FlightStatus::Aborted, format!("the {process} ended before it had landed"))
                }
                None => return self.note_deaths(report),
            },
            None if self.is_over() => (FlightStatus::Interrupted, "interrupted".into()),
            None => (FlightStatus::Aborted, "the recorder ended too early".into()),
        };
        let killed = self.killed.iter().map(|role| {
            let process = process(*role) + &flying(report, *role);
            format!("; the {process} did not end within {} s of being told to and was killed", LANDING.as_secs())
        });
        let ending = std::iter::once(ending).chain(killed).collect();
        break_off(report, status, ending);
        self.note_deaths(report);
        true
    }

    /// Puts in how processes died that were started again or ended the flight; says whether there were any.
    fn note_deaths(&self, report: &mut Report) -> bool {
        if let Some(Pace::Realtime(grid)) = &self.grid {
            deaths::note(report, &self.noted, grid);
        }
        self.grid.is_some()
    }

    /// The first stage whose figures the recorder waited for in vain, and that did not live on after the flight: an exit
    /// code of 0 alone does not say that it landed. Deaths that were noted are told as such.
    fn unlanded(&self, report: &Report) -> Option<Role> {
        let has_landed = |role: Role| report.roles.get(role.name()).is_none_or(|section| section.landed);
        let is_noted = |role: Role| self.noted.iter().any(|death| death.role == role.name());
        STAGES.into_iter().find(|role| !has_landed(*role) && !self.outlasted.contains(role) && !is_noted(*role))
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
    pub(super) fn was_interrupted(&self) -> bool {
        self.status.code() == Some(i32::from(INTERRUPTED)) || self.status.signal().is_some_and(asks_for_the_end)
    }

    /// The end of what the process said, a line each, as a terminal and a page show it.
    fn last_words(&self, directory: &Path) -> Vec<String> {
        const MOST_LINES: usize = 40;
        const MOST_CHARACTERS: usize = 400;
        let said = said(directory, self.role);
        let lines: Vec<&str> = said.lines().collect();
        let last = &lines[lines.len().saturating_sub(MOST_LINES)..];
        last.iter().map(|line| harmless(&line.chars().take(MOST_CHARACTERS).collect::<String>())).collect()
    }

    /// How it ended, in a word or two.
    pub(super) fn cause(&self) -> String {
        match self.killed {
            Some(Killed::Hung) => "hung, and was killed".into(),
            Some(Killed::ByFault(tick)) => format!("killed by the fault {}.kill of tick {tick}", self.role),
            Some(Killed::AfterFlight) | None => self.status.to_string(),
        }
    }

    /// What the process said, with how it ended.
    pub(super) fn words(&self, directory: &Path) -> String {
        let mut said = said(directory, self.role);
        if said.is_empty() && is_full(directory) {
            said = format!("{}: the disk is full, and had no room for what the process said\n", directory.display());
        }
        format!("{}: {}\n{said}", process(self.role), self.status)
    }

    /// How it ended, in words; with what it was flying.
    pub(super) fn how(&self, flying: &str) -> String {
        let process = process(self.role) + flying;
        let how = match self.killed {
            Some(Killed::AfterFlight) => {
                format!("the {process} did not end within {} s of the flight and was killed", ENDING.as_secs())
            }
            Some(Killed::Hung) => format!("the {process} hung, and was killed"),
            Some(Killed::ByFault(tick)) => {
                format!("the {process} was killed by the fault {}.kill of tick {tick}", self.role)
            }
            None if self.is_in_order() => format!("the {process} ended before the flight did: {}", self.status),
            None => format!("the {process} died: {}", self.status),
        };
        self.not_again.iter().fold(how, |how, why| format!("{how}; {why}"))
    }
}

/// The law that a role flew, where it is one of a file: it is the first to be asked why its process ended.
fn flying(report: &Report, role: Role) -> String {
    let law = report.run.laws.get(role.name()).filter(|law| law.file.is_some());
    law.map_or_else(String::new, |law| format!(", which flew the law {},", law.named()))
}

/// What the processes of a flight warn of, a line each, as far as anybody reads them.
pub(super) fn warnings(directory: &Path) -> Vec<String> {
    const MOST_LINES: usize = 20;
    let said = |role: &Role| fs::read(log_path(directory, *role)).unwrap_or_default();
    let warns = |said: Vec<u8>| -> Vec<String> {
        let said = String::from_utf8_lossy(&said).into_owned();
        said.lines().filter(|line| line.starts_with("warning: ")).map(harmless).collect()
    };
    ROLES.iter().map(said).flat_map(warns).take(MOST_LINES).collect()
}

/// What the process of a role is called.
pub(super) fn process(role: Role) -> String {
    if role == Role::Record { "recorder".into() } else { format!("{role} process") }
}

fn is_full(directory: &Path) -> bool {
    const A_WORD_BYTES: u64 = 16 << 10;
    statvfs(directory).is_ok_and(|disk| disk.f_bavail * disk.f_frsize < A_WORD_BYTES)
}

/// What a process said. A law's code may say anything: bytes that are no text are shown as such, and hide nothing else.
fn said(directory: &Path, role: Role) -> String {
    let bytes = fs::read(log_path(directory, role)).unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
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
        let status = ExitStatus::from_raw(raw);
        Left { role, pid: 1, status, interrupted: false, killed: None, not_again: None }
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
    fn the_end_of_what_a_dead_process_said_is_kept_and_harmless() {
        let directory = tempfile::tempdir().unwrap();
        let said_bytes = |text: &[u8]| {
            fs::write(log_path(directory.path(), Role::Inner), text).unwrap();
            left(Role::Inner, code(1)).last_words(directory.path())
        };
        let said = |text: &str| said_bytes(text.as_bytes());
        assert_eq!(said("Traceback:\n  gain\nerror: \x1b[31mred\n"), ["Traceback:", "  gain", "error: \\u{1b}[31mred"]);
        assert_eq!(said_bytes(b"\xff\xfe\nerror: SIGSEGV\n"), ["\u{fffd}\u{fffd}", "error: SIGSEGV"]);
        let long: String = (0..100).map(|i| format!("{i}\n")).collect();
        let kept = said(&(long + &"x".repeat(1000)));
        assert_eq!((kept.len(), kept[0].as_str(), kept[39].len()), (40, "61", 400));
        assert!(left(Role::Outer, code(1)).last_words(directory.path()).is_empty());
    }

    #[test]
    fn an_interruption_is_one_whatever_the_processes_make_of_it() {
        let mut ended = Ended { interrupted: true, ..Ended::default() };
        ended.take(Left { interrupted: true, ..left(Role::Outer, code(1)) }, true, true);
        assert_eq!(ended.failure(Path::new("/nonexistent")).code, INTERRUPTED);
    }
}
