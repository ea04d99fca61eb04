//! Runs a flight as one side of a comparison: started as a user would, results read from its report.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::settings::Settings;
use analysis::report_file::RunFacts;
use analysis::schema::Report;
use analysis::series::Statistics;
use errors::{Failure, GATE, InFile as _, OK};
use host::own_executable;

#[derive(Debug)]
pub struct FlightRunner {
    executable: PathBuf,
    instance: String,
    directory: tempfile::TempDir,
    launched: AtomicU64,
}

impl FlightRunner {
    pub fn new() -> Result<Self, Failure> {
        let executable = own_executable()?;
        let directory = tempfile::tempdir().map_err(|e| {
            Failure::failed(format!("cannot make a temporary directory: {e}")).help("set TMPDIR")
        })?;
        Ok(Self {
            executable,
            instance: format!("floor-{}", std::process::id()),
            directory,
            launched: AtomicU64::new(0),
        })
    }

    pub fn executable(&self) -> &Path {
        &self.executable
    }

    pub fn directory(&self) -> &Path {
        self.directory.path()
    }

    /// The command of a flight with these flags, and its future run directory.
    pub fn command(&self, flags: &[&str]) -> (Command, PathBuf) {
        let out = self.directory.path().join(format!(
            "flight{}",
            self.launched.fetch_add(1, Ordering::Relaxed)
        ));
        let mut command = Command::new(&self.executable);
        command
            .arg("fly")
            .args(flags)
            .args(["--instance", &self.instance])
            .arg("--out")
            .arg(&out);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        (command, out.join("latest"))
    }

    pub fn fly(&self, flags: &[&str]) -> Result<Report, Failure> {
        let (mut command, run) = self.command(flags);
        let output = command
            .output()
            .map_err(|e| Failure::failed(format!("cannot launch a flight: {e}")))?;
        // A failed acceptance criterion does not invalidate the measurement.
        let ended = command_end("a flight", &output);
        if !matches!(output.status.code(), Some(code) if [OK, GATE].map(i32::from).contains(&code))
        {
            return Err(Failure::failed(ended));
        }
        let report =
            Report::read(&run.join("report.json")).map_err(|e| e.append(&format!("; {ended}")))?;
        complete(report, requested_ticks(&run.join("run.json"))?)
    }
}

/// How a command ended, with what it printed to standard error.
pub(super) fn command_end(what: &str, output: &Output) -> String {
    let complaint = String::from_utf8_lossy(&output.stderr);
    format!("{what} ended with {}: {}", output.status, complaint.trim())
}

fn requested_ticks(path: &Path) -> Result<u64, Failure> {
    let text = fs::read_to_string(path).in_file("read", path)?;
    let facts: RunFacts = serde_json::from_str(&text).in_file("read", path)?;
    let settings: Settings = serde_json::from_value(facts.settings).in_file("read", path)?;
    Ok(settings.last_tick() + 1)
}

fn complete(report: Report, requested_ticks: u64) -> Result<Report, Failure> {
    let ticks = report.ticks.run + report.ticks.skipped;
    if ticks == requested_ticks && !report.run.in_flight {
        return Ok(report);
    }
    let ending = &report.run.ending;
    Err(Failure::failed(format!(
        "a flight of {requested_ticks} ticks ended after {ticks}: {ending}"
    )))
}

pub fn series<'a>(report: &'a Report, name: &str) -> Result<&'a Statistics, Failure> {
    let found = report.series.iter().find(|series| series.name == name);
    found.ok_or_else(|| Failure::failed(format!("the flight's report has no series `{name}`")))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    /// Runs a shell script in place of ironbird; `$OUT` is the directory for its flight.
    fn flights(script: &str) -> FlightRunner {
        let directory = tempfile::tempdir().unwrap();
        let executable = directory.path().join("script");
        let script = format!("#!/bin/sh\nfor OUT; do :; done\n{script}\n");
        fs::write(&executable, script).unwrap();
        fs::set_permissions(&executable, fs::Permissions::from_mode(0o755)).unwrap();
        FlightRunner {
            executable,
            instance: "made-up".into(),
            directory,
            launched: AtomicU64::new(0),
        }
    }

    #[test]
    fn a_failed_flight_is_no_measurement_whatever_its_directory_contains() {
        for code in [1, 2, 4, 5, 130] {
            let script = format!(
                "mkdir -p $OUT/latest; echo '{{}}' > $OUT/latest/report.json; echo why >&2; exit {code}"
            );
            let error = flights(&script).fly(&[]).unwrap_err().to_string();
            assert!(
                error.contains(&format!("a flight ended with exit status: {code}: why")),
                "{error}"
            );
        }
        let flights = flights("exit 0");
        assert_ne!(flights.command(&[]).1, flights.command(&[]).1);
        let error = flights.fly(&[]).unwrap_err().to_string();
        assert!(
            error.contains("report.json: No such file")
                && error.contains("ended with exit status: 0"),
            "{error}"
        );
    }
}
