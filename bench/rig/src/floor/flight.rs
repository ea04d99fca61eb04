//! A flight as one side of a comparison: launched as a user would, read from its report.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::settings::Settings;
use failure::{Failure, GATE, InFile as _, OK};
use machine::executable::own_executable;
use report::run_facts::RunFacts;
use report::schema::Report;
use report::tally::series::Statistics;

/// Launches flights of an executable, one after the other.
#[derive(Debug)]
pub struct Hangar {
    executable: PathBuf,
    instance: String,
    /// Removed with everything in it.
    directory: tempfile::TempDir,
    /// Flights so far.
    launched: AtomicU64,
}

impl Hangar {
    /// For flights of the present executable.
    ///
    /// # Errors
    /// [`Failure`] where the executable is not known or there is no place for temporary files.
    pub fn new() -> Result<Self, Failure> {
        let executable = own_executable()?;
        let directory = tempfile::tempdir()
            .map_err(|e| Failure::failed(format!("cannot make a temporary directory: {e}")).help("set TMPDIR"))?;
        Ok(Self {
            executable,
            instance: format!("floor-{}", std::process::id()),
            directory,
            launched: AtomicU64::new(0),
        })
    }

    /// The executable.
    #[must_use]
    pub fn executable(&self) -> &Path {
        &self.executable
    }

    /// The instance that its flights are.
    #[must_use]
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// A place for temporary files.
    #[must_use]
    pub fn directory(&self) -> &Path {
        self.directory.path()
    }

    /// The command of a flight with these flags, and where its directory will be when it has a report: only its own.
    #[must_use]
    pub fn command(&self, flags: &[&str]) -> (Command, PathBuf) {
        let out = self.directory.path().join(format!("flight{}", self.launched.fetch_add(1, Ordering::Relaxed)));
        let mut command = Command::new(&self.executable);
        command.arg("fly").args(flags).args(["--instance", &self.instance]).arg("--out").arg(&out);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        (command, out.join("latest"))
    }

    /// Flies, and gives the report.
    ///
    /// # Errors
    /// [`Failure`] where the flight cannot be launched or leaves no report of all its ticks, with its complaints.
    pub fn fly(&self, flags: &[&str]) -> Result<Report, Failure> {
        let (mut command, run) = self.command(flags);
        let output = command.output().map_err(|e| Failure::failed(format!("cannot launch a flight: {e}")))?;
        // A gate that does not hold is no reason to throw a measurement away.
        let landed = output.status.code().is_some_and(|code| [OK, GATE].map(i32::from).contains(&code));
        let complaint = String::from_utf8_lossy(&output.stderr);
        let ended = || format!("a flight ended with {}: {}", output.status, complaint.trim());
        if !landed {
            return Err(Failure::failed(ended()));
        }
        let report = Report::read(&run.join("report.json")).map_err(|e| e.append(&format!("; {}", ended())))?;
        whole(report, asked_ticks(&run.join("run.json"))?)
    }
}

/// The ticks that a flight was asked for.
fn asked_ticks(path: &Path) -> Result<u64, Failure> {
    let text = fs::read_to_string(path).in_file("read", path)?;
    let facts: RunFacts = serde_json::from_str(&text).in_file("read", path)?;
    let settings: Settings = serde_json::from_value(facts.settings).in_file("read", path)?;
    Ok(settings.last_tick() + 1)
}

/// A report of so many ticks: a flight that has ended before measures something else.
fn whole(report: Report, asked_ticks: u64) -> Result<Report, Failure> {
    let ticks = report.ticks.run + report.ticks.skipped;
    if ticks == asked_ticks && !report.run.in_flight {
        return Ok(report);
    }
    let ending = &report.run.ending;
    Err(Failure::failed(format!("a flight of {asked_ticks} ticks ended after {ticks}: {ending}")))
}

/// A series of a report.
///
/// # Errors
/// [`Failure`] names the series that is not there.
pub fn series<'a>(report: &'a Report, name: &str) -> Result<&'a Statistics, Failure> {
    let found = report.series.iter().find(|series| series.name == name);
    found.ok_or_else(|| Failure::failed(format!("the flight's report has no series `{name}`")))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    /// Launches a shell script in the place of ironbird; `$OUT` is where its flight shall be recorded.
    fn hangar(script: &str) -> Hangar {
        let directory = tempfile::tempdir().unwrap();
        let executable = directory.path().join("script");
        let script = format!("#!/bin/sh\nfor OUT; do :; done\n{script}\n");
        fs::write(&executable, script).unwrap();
        fs::set_permissions(&executable, fs::Permissions::from_mode(0o755)).unwrap();
        Hangar { executable, instance: "made-up".into(), directory, launched: AtomicU64::new(0) }
    }

    #[test]
    fn no_flight_is_read_from_the_directory_of_another_one() {
        let hangar = hangar("exit 5");
        let (first, second) = (hangar.command(&[]), hangar.command(&[]));
        assert_ne!(first.1, second.1);
        assert_eq!(first.0.get_args().last().map(Path::new), first.1.parent());
    }

    #[test]
    fn a_flight_that_failed_is_no_measurement_whatever_lies_in_its_directory() {
        for code in [1, 2, 4, 5, 130] {
            let script =
                format!("mkdir -p $OUT/latest; echo '{{}}' > $OUT/latest/report.json; echo why >&2; exit {code}");
            let error = hangar(&script).fly(&[]).unwrap_err().to_string();
            assert!(error.contains(&format!("a flight ended with exit status: {code}: why")), "{error}");
        }
        let error = hangar("exit 0").fly(&[]).unwrap_err().to_string();
        assert!(error.contains("report.json: No such file") && error.contains("ended with exit status: 0"), "{error}");
    }
}
