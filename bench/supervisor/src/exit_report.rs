//! How a flight's processes ended, and what that means for its report and exit code.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::ExitStatus;

use messages::grid::Pace;
use messages::role::{MOST_CHANNELS, Replica, Role, STAGES};
use process::signals::asks_for_the_end;
use rustix::fs::statvfs;

use crate::child_process::{LANDING_TIMEOUT, STOP_TIMEOUT, log_path, title};
use analysis::faults::InjectedFault;
use analysis::gates::break_off;
use analysis::process_failures::{self, ObservedFailure};
use analysis::schema::{FlightStatus, Report};
use errors::output::say;
use errors::{FAILED, Failure, GATE, INTERRUPTED, harmless};
use host::Machine;

#[derive(Default)]
pub struct Outcome {
    /// The process whose end ended the flight.
    pub failed: Option<ProcessExit>,
    /// The process that a signal of another process ended.
    pub(super) stopped: Option<ProcessExit>,
    /// Whether a signal to the supervisor requested the end.
    pub(super) interrupted: bool,
    pub(super) flown: bool,
    /// Processes that the supervisor killed because they did not end on request.
    pub(super) killed: Vec<Replica>,
    /// Processes that were running when the plant had closed the run.
    pub(super) outlasted: Vec<Replica>,
    /// Processes that failed in flight.
    pub(super) noted: Vec<ObservedFailure>,
    /// Faults of processes that began after their tick.
    pub(super) delayed: Vec<InjectedFault>,
    /// The pace of the ticks in which they failed.
    pub(super) grid: Option<Pace>,
}

pub struct ProcessExit {
    pub(super) replica: Replica,
    pub(super) pid: u32,
    pub(super) status: ExitStatus,
    /// Whether a signal to the supervisor had requested the end by then.
    pub(super) interrupted: bool,
    /// Why it was killed, where that is known.
    pub(super) killed: Option<KillReason>,
    pub(super) not_restarted: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KillReason {
    Hang,
    /// Two channels contradicted its own.
    Outvoted,
    AfterFlight,
    /// The process ran another program.
    Replaced,
    /// The process made no progress at the start: the step that is missing.
    Late(&'static str),
    /// A fault of this tick.
    Fault(u64),
    /// Lack of memory, by the kernel.
    Memory,
}

impl Outcome {
    /// Takes the exit of a process: on request of the supervisor, if `requested`; before the plant has closed the run,
    /// if `early`. An early exit is a failure even with exit code 0, which may be a law's.
    pub(super) fn take(&mut self, exit: ProcessExit, requested: bool, early: bool) {
        if exit.was_interrupted() {
            if !requested {
                self.stopped.get_or_insert(exit);
            }
        } else if !exit.is_in_order() || early && !requested {
            // A recorder that ends because another process failed may be reaped before that one.
            let known = self.failed.as_ref();
            if known.is_none_or(|known| known.replica.role == Role::Record) {
                self.failed = Some(exit);
            }
        }
    }

    /// Whether the other processes have no reason to go on.
    pub(super) const fn is_over(&self) -> bool {
        self.interrupted || self.failed.is_some() || self.stopped.is_some()
    }

    /// Adds to the report what the recorder could not know: that a process failed, or that its own final message is
    /// missing. Returns whether there was anything to add.
    pub fn correct(&self, report: &mut Report, directory: &Path) -> bool {
        let mut reason = String::new();
        // A recorder that ends badly after its final report takes nothing away from it.
        let failed = self.failed.as_ref();
        let failed = failed.filter(|it| it.replica.role != Role::Record || report.run.in_flight);
        let (status, ending) = if let Some(failed) = failed {
            report.run.last_words = failed.last_lines(directory);
            let law = flown_law(report, failed.replica);
            let ending = failed.describe(&law);
            reason = failed.error(directory).unwrap_or_else(|| ending.clone());
            (FlightStatus::Aborted, ending)
        } else if !report.run.in_flight {
            let role = self
                .role_without_landing(report)
                .filter(|_| !self.is_over());
            let Some(role) = role else {
                return self.note_failures(report);
            };
            let process = title(role.into()) + &flown_law(report, role.into());
            let ending = format!("the {process} ended before it had landed");
            (FlightStatus::Aborted, ending)
        } else if self.is_over() {
            (FlightStatus::Interrupted, "interrupted".into())
        } else {
            (FlightStatus::Aborted, "the recorder ended too early".into())
        };
        let mut ending: String = ending;
        for replica in &self.killed {
            let (process, law) = (title(*replica), flown_law(report, *replica));
            let seconds = STOP_TIMEOUT.as_secs();
            ending += &format!(
                "; the {process}{law} did not end within {seconds} s of SIGTERM and was killed"
            );
        }
        break_off(report, status, ending, &reason);
        self.note_failures(report);
        true
    }

    /// Adds the processes that failed in flight, and the faults that were late, to the report; returns whether there were any.
    fn note_failures(&self, report: &mut Report) -> bool {
        for fault in &mut report.faults {
            self.delayed.iter().for_each(|delayed| fault.note(delayed));
        }
        if !self.delayed.is_empty() {
            let period_s = report.run.period_us / 1e6;
            let outages = std::mem::take(&mut report.autopsy);
            report.autopsy = outages.with_faults(&report.faults, period_s, &report.deaths);
        }
        if let Some(pace) = &self.grid {
            process_failures::note(report, &self.noted, pace);
        }
        self.grid.is_some() || !self.delayed.is_empty()
    }

    /// The first stage whose final figures the recorder did not get, and that was gone when the run was closed: an exit
    /// code of 0 alone does not show that it landed. Failures in flight are reported as such.
    fn role_without_landing(&self, report: &Report) -> Option<Role> {
        let has_landed = |role: &Role| {
            let section = report.roles.get(role.name());
            section.is_none_or(|section| section.landed)
        };
        let outlasted = |role: &Role| self.outlasted.contains(&Replica::from(*role));
        let is_noted = |role: &Role| self.noted.iter().any(|noted| noted.role == role.name());
        STAGES
            .into_iter()
            .find(|role| !has_landed(role) && !outlasted(role) && !is_noted(role))
    }

    /// The error of a flight without a report.
    pub(super) fn failure(&self, directory: &Path) -> Failure {
        for exit in self.failed.iter().chain(&self.stopped) {
            say(&exit.log(directory));
        }
        let when = if self.flown {
            "the flight had a report"
        } else {
            "the flight began"
        };
        if let Some(stopped) = &self.stopped {
            let what = format!(
                "the {} was interrupted before {when}",
                title(stopped.replica)
            );
            return Failure::new(INTERRUPTED, what);
        }
        match &self.failed {
            // After a signal, the failure of a process is its consequence.
            Some(failed) if !failed.interrupted => {
                let code = failed
                    .status
                    .code()
                    .and_then(|code| u8::try_from(code).ok());
                let title = title(failed.replica);
                if let Some(KillReason::Late(why)) = failed.killed {
                    let what = format!("the flight did not begin: the {title} is late: {why}");
                    return Failure::failed(what)
                        .help("rt.start_timeout_s says how long no process may come further");
                }
                let what = format!("the {title} ended before {when}");
                let failure = Failure::new(code.filter(|code| *code != 0).unwrap_or(FAILED), what);
                match self.flown {
                    true => failure.help(
                        "the recorder writes the first report after one second of flight; `ironbird export` exports what was logged",
                    ),
                    false => failure,
                }
            }
            _ if self.interrupted => {
                Failure::new(INTERRUPTED, format!("interrupted before {when}"))
            }
            _ => Failure::failed("the processes ended without a report"),
        }
    }
}

impl ProcessExit {
    /// Whether it did what it should; the recorder's exit code is the flight's verdict.
    pub(super) fn is_in_order(&self) -> bool {
        self.status.success()
            || (self.replica.role == Role::Record && self.status.code() == Some(i32::from(GATE)))
    }

    /// Whether a signal requested its end, even before the process could handle it.
    pub(super) fn was_interrupted(&self) -> bool {
        self.status.code() == Some(i32::from(INTERRUPTED))
            || self.status.signal().is_some_and(asks_for_the_end)
    }

    /// The last lines of its log, fit for a terminal and a page.
    fn last_lines(&self, directory: &Path) -> Vec<String> {
        const MAX_LINES: usize = 40;
        const MAX_CHARACTERS: usize = 400;
        let log = read_log(directory, self.replica);
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(MAX_LINES)..]
            .iter()
            .map(|line| harmless(&line.chars().take(MAX_CHARACTERS).collect::<String>()))
            .collect()
    }

    /// The error that it, or its law, wrote as its last one before it ended of its own accord.
    fn error(&self, directory: &Path) -> Option<String> {
        const SIGKILL: i32 = signal_hook::consts::SIGKILL;
        let of_its_own = self.killed.is_none() && self.status.signal() != Some(SIGKILL);
        let log = read_log(directory, self.replica);
        let mut errors = log.lines().rev();
        let error = errors.find_map(|line| line.strip_prefix("error: "));
        error.filter(|_| of_its_own).map(harmless)
    }

    /// How it ended, in a few words.
    pub(super) fn cause(&self) -> String {
        match self.killed {
            Some(KillReason::Hang) => "hung, and was killed".into(),
            Some(KillReason::Outvoted) => "killed: two channels contradicted its channel".into(),
            Some(KillReason::Fault(tick)) => {
                format!("killed by the fault {}.kill of tick {tick}", self.replica)
            }
            Some(KillReason::Memory) => {
                let limit = Machine::files().group_limit("self", "memory");
                let limit = limit.map(|(mib, _)| format!(": its container may use {mib:.0} MiB"));
                "killed for lack of memory".to_owned() + &limit.unwrap_or_default()
            }
            Some(KillReason::Replaced) => "replaced by another program, and killed".into(),
            Some(KillReason::Late(why)) => format!("late, and was killed: {why}"),
            Some(KillReason::AfterFlight) | None => self.status.to_string(),
        }
    }

    /// How it ended, and its log.
    pub fn log(&self, directory: &Path) -> String {
        let mut log = read_log(directory, self.replica);
        if log.is_empty() && is_full(directory) {
            log = format!(
                "{}: the disk is full, and had no room for the messages of the process\n",
                directory.display()
            );
        }
        format!("{}: {}\n{log}", title(self.replica), self.cause())
    }

    /// How it ended, as a clause, with the law that it flew.
    pub(super) fn describe(&self, law: &str) -> String {
        let process = title(self.replica) + law;
        let how = match self.killed {
            Some(KillReason::AfterFlight) => format!(
                "the {process} did not end within {} s of the flight and was killed",
                LANDING_TIMEOUT.as_secs()
            ),
            Some(KillReason::Hang) => format!("the {process} hung, and was killed"),
            Some(_) => format!("the {process} was {}", self.cause()),
            None if self.is_in_order() => {
                format!("the {process} ended before the flight did: {}", self.status)
            }
            None => format!("the {process} died: {}", self.status),
        };
        self.not_restarted
            .iter()
            .fold(how, |how, why| format!("{how}; {why}"))
    }
}

/// The law that a role flew, if it comes from a file: it is the first suspect when the process ends.
fn flown_law(report: &Report, replica: Replica) -> String {
    let channels = report.redundancy.as_ref();
    if let Some(law) = channels.and_then(|it| it.laws.get(&replica.to_string())) {
        return format!(", which flew the law {law},");
    }
    match report.run.laws.get(replica.role.name()) {
        Some(law) if law.file.is_some() => {
            format!(", which flew the law {},", render::sentences::law(law))
        }
        _ => String::new(),
    }
}

/// The warnings of a flight's processes, a line each, up to a number that a user still reads.
pub fn warnings(directory: &Path) -> Vec<String> {
    const MAX_LINES: usize = 20;
    let logs = Replica::all(MOST_CHANNELS).map(|replica| read_log(directory, replica));
    let logs = logs.collect::<Vec<_>>().join("\n");
    let warnings = logs.lines().filter(|line| line.starts_with("warning: "));
    warnings.map(harmless).take(MAX_LINES).collect()
}

fn is_full(directory: &Path) -> bool {
    const MESSAGE_BYTES: u64 = 16 << 10;
    statvfs(directory).is_ok_and(|disk| disk.f_bavail * disk.f_frsize < MESSAGE_BYTES)
}

/// The log of a role's processes. A law may write anything into it, also bytes that are not text.
fn read_log(directory: &Path, replica: Replica) -> String {
    let bytes = fs::read(log_path(directory, replica)).unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

    use super::*;

    fn exit(role: Role, raw: i32) -> ProcessExit {
        ProcessExit {
            replica: role.into(),
            pid: 1,
            status: ExitStatus::from_raw(raw),
            interrupted: false,
            killed: None,
            not_restarted: None,
        }
    }

    /// The wait status of an exit code, which is its second byte; a signal is the first one.
    const fn code(code: i32) -> i32 {
        code << 8
    }

    #[test]
    fn an_early_exit_ends_the_flight_with_the_code_of_its_process() {
        for (role, raw, early, is_over, exit_code) in [
            (Role::Outer, code(0), true, true, FAILED),
            (Role::Outer, code(130), true, true, INTERRUPTED),
            (Role::Outer, code(5), true, true, 5),
            (Role::Outer, 9, true, true, FAILED),
            (Role::Plant, SIGTERM, true, true, INTERRUPTED),
            (Role::Plant, SIGHUP, true, true, INTERRUPTED),
            (Role::Plant, SIGINT, true, true, INTERRUPTED),
            (Role::Plant, SIGQUIT, true, true, INTERRUPTED),
            (Role::Outer, code(0), false, false, FAILED),
            (Role::Record, code(3), false, false, FAILED),
            (Role::Mixer, code(3), false, true, 3),
        ] {
            let mut outcome = Outcome::default();
            outcome.take(exit(role, raw), false, early);
            let failure = outcome.failure(Path::new("/nonexistent"));
            assert_eq!(
                (outcome.is_over(), failure.code),
                (is_over, exit_code),
                "{role} {raw}"
            );
        }
    }

    #[test]
    fn the_first_failure_is_reported_and_not_a_recorder_that_follows() {
        let mut outcome = Outcome::default();
        outcome.take(exit(Role::Record, code(1)), false, false);
        outcome.take(exit(Role::Inner, 9), false, false);
        outcome.take(exit(Role::Mixer, code(1)), true, false);
        outcome.take(exit(Role::Plant, code(130)), true, false);
        outcome.flown = true;
        let failure = outcome.failure(Path::new("/nonexistent"));
        let help = "the recorder writes the first report after one second of flight";
        assert!(failure.remedy().is_some_and(|it| it.starts_with(help)));
        assert_eq!(
            outcome.failed.map(|exit| exit.replica.role),
            Some(Role::Inner)
        );
        assert!(outcome.stopped.is_none(), "its end was requested");
    }

    #[test]
    fn the_last_lines_of_a_log_are_kept_and_harmless() {
        let directory = tempfile::tempdir().unwrap();
        let last_lines = |log: &[u8]| {
            fs::write(log_path(directory.path(), Role::Inner.into()), log).unwrap();
            exit(Role::Inner, code(1)).last_lines(directory.path())
        };
        let lines = last_lines(b"Traceback:\n  gain\nerror: \x1b[31mred\n");
        assert_eq!(lines, ["Traceback:", "  gain", "error: \\u001b[31mred"]);
        let lines = last_lines(b"\xff\xfe\nerror: SIGSEGV\n");
        assert_eq!(lines, ["\u{fffd}\u{fffd}", "error: SIGSEGV"]);
        let long: String = (0..100).map(|i| format!("{i}\n")).collect();
        let lines = last_lines((long + &"x".repeat(1000)).as_bytes());
        assert_eq!(
            (lines.len(), lines[0].as_str(), lines[39].len()),
            (40, "61", 400)
        );
        let outer = exit(Role::Outer, code(1));
        assert!(outer.last_lines(directory.path()).is_empty());
    }

    #[test]
    fn after_an_interruption_the_failure_of_a_process_is_no_other_error() {
        let mut outcome = Outcome {
            interrupted: true,
            ..Outcome::default()
        };
        let failed = ProcessExit {
            interrupted: true,
            ..exit(Role::Outer, code(1))
        };
        outcome.take(failed, true, true);
        assert_eq!(outcome.failure(Path::new("/nonexistent")).code, INTERRUPTED);
    }

    #[test]
    fn a_description_says_how_a_process_ended_and_why_it_was_not_restarted() {
        let killed = ProcessExit {
            killed: Some(KillReason::AfterFlight),
            ..exit(Role::Inner, 9)
        };
        let plant = ProcessExit {
            not_restarted: Some("no reason".into()),
            ..exit(Role::Plant, code(3))
        };
        for (exit, expected) in [
            (
                killed,
                "the inner process did not end within 30 s of the flight and was killed",
            ),
            (
                exit(Role::Record, code(3)),
                "the recorder ended before the flight did: exit status: 3",
            ),
            (plant, "the plant process died: exit status: 3; no reason"),
        ] {
            assert_eq!(exit.describe(""), expected);
        }
        let hung = ProcessExit {
            killed: Some(KillReason::Hang),
            ..exit(Role::Record, 9)
        };
        let log = hung.log(Path::new("/nonexistent"));
        assert!(log.starts_with("recorder: hung, and was killed\n"), "{log}");
    }

    #[test]
    fn a_report_is_corrected_only_by_what_its_recorder_could_not_see() {
        let reports = concat!(env!("CARGO_MANIFEST_DIR"), "/../render/tests/reports");
        let whole = Report::read(&Path::new(reports).join("lockstep/report.json")).unwrap();
        let corrected = |outcome: Outcome, in_flight: bool, plant_landed: bool| {
            let mut report = whole.clone();
            report.run.in_flight = in_flight;
            report.roles.get_mut("plant").unwrap().landed = plant_landed;
            let is_corrected = outcome.correct(&mut report, Path::new("/nonexistent"));
            let (status, ending) = (report.verdict.status, report.run.ending);
            is_corrected.then(|| format!("{status:?}: {ending}"))
        };
        let outlasted = || Outcome {
            outlasted: vec![Role::Plant.into()],
            ..Outcome::default()
        };
        let interrupted = || Outcome {
            interrupted: true,
            ..Outcome::default()
        };
        let failed = || Outcome {
            failed: Some(exit(Role::Outer, 9)),
            killed: vec![Role::Mixer.into()],
            ..Outcome::default()
        };
        let recorder_killed = || Outcome {
            failed: Some(exit(Role::Record, 9)),
            ..Outcome::default()
        };
        let not_corrected = [
            corrected(Outcome::default(), false, true),
            // After its final report.
            corrected(recorder_killed(), false, true),
            corrected(outlasted(), false, false),
            corrected(interrupted(), false, false),
        ];
        assert_eq!(not_corrected, [const { None }; 4]);
        let all = [
            corrected(Outcome::default(), false, false),
            corrected(interrupted(), true, true),
            corrected(Outcome::default(), true, true),
            corrected(failed(), false, true),
            corrected(recorder_killed(), true, true),
        ];
        let expected = [
            "Aborted: the plant process ended before it had landed",
            "Interrupted: interrupted; the numbers end 0.3 s into the flight",
            "Aborted: the recorder ended too early; the numbers end 0.3 s into the flight",
            "Aborted: the outer process died: signal: 9 (SIGKILL); the mixer process did not end within 5 s of SIGTERM \
             and was killed",
            "Aborted: the recorder died: signal: 9 (SIGKILL); the numbers end 0.3 s into the flight",
        ];
        assert_eq!(all.map(Option::unwrap), expected);
    }

    #[test]
    fn the_verdict_names_the_error_that_ended_the_flight_and_not_the_end_that_it_led_to() {
        let reports = concat!(env!("CARGO_MANIFEST_DIR"), "/../render/tests/reports");
        let mut report = Report::read(&Path::new(reports).join("lockstep/report.json")).unwrap();
        let flown_s = report.ticks.flown_s(&report.run);
        report
            .words
            .cut_short("interrupted", "", &report.ticks, flown_s);
        let before = report.words.flight.clone();
        let directory = tempfile::tempdir().unwrap();
        let log =
            "Traceback\nerror: the inner law `l` (l.py:3) failed in tick 5: KeyError: 'gain'\n";
        fs::write(log_path(directory.path(), Role::Inner.into()), log).unwrap();
        for (raw, reason) in [
            (
                code(1),
                "the inner law `l` (l.py:3) failed in tick 5: KeyError: 'gain'",
            ),
            (9, "the inner process died: signal: 9 (SIGKILL)"),
        ] {
            let mut report = report.clone();
            let outcome = Outcome {
                failed: Some(exit(Role::Inner, raw)),
                ..Outcome::default()
            };
            outcome.correct(&mut report, directory.path());
            let until_then = before.until_then.as_deref().unwrap();
            let flown = before.why.replace("interrupted", "aborted");
            let flown = flown.strip_suffix(&format!("; until then {until_then}"));
            let flown = flown.unwrap();
            let expected = format!("{flown}: {reason}; until then {until_then}");
            assert_eq!(report.words.flight.why, expected);
            assert_eq!(report.words.flight.until_then, before.until_then);
            let timing = report.words.timing.why;
            assert!(
                timing.starts_with(&format!("{flown}; until then ")),
                "{timing}"
            );
        }
    }
}
