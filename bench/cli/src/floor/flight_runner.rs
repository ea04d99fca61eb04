//! Runs a flight as one side of a comparison: started as a user would, results read from its report.

use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};

use analysis::report_file::RunFacts;
use analysis::schema::Report;
use analysis::series::Statistics;
use config::Settings;
use errors::{Failure, GATE, InFile as _, OK};
use host::own_executable;
use recorder::run_directory::FACTS;

#[derive(Debug)]
pub struct FlightRunner {
    pub executable: PathBuf,
    instance: String,
    pub directory: tempfile::TempDir,
    launched: AtomicU64,
}

#[derive(Debug)]
pub struct Flown {
    pub report: Report,
    pub settings: Settings,
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

    pub fn fly(&self, flags: &[&str]) -> Result<Flown, Failure> {
        let number = self.launched.fetch_add(1, Ordering::Relaxed);
        let out = self.directory.path().join(format!("flight{number}"));
        let mut command = process::signals::child(&self.executable, "fly");
        command.args(flags);
        command.args(["--instance", &self.instance]);
        command.arg("--out").arg(&out).stdin(Stdio::null());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        let run = out.join("latest");
        let output = command
            .output()
            .map_err(|e| Failure::failed(format!("cannot launch a flight: {e}")))?;
        // A failed acceptance criterion does not invalidate the measurement.
        let complaint = String::from_utf8_lossy(&output.stderr);
        let ended = format!(
            "a flight ended with {}: {}",
            output.status,
            complaint.trim()
        );
        let flown = [OK, GATE].map(|code| Some(i32::from(code)));
        if !flown.contains(&output.status.code()) {
            return Err(Failure::failed(ended));
        }
        let report =
            Report::read(&run.join("report.json")).map_err(|e| e.append(&format!("; {ended}")))?;
        let path = run.join(FACTS);
        let settings = RunFacts::read(&path)?.settings;
        let settings: Settings = serde_json::from_value(settings).in_file("read", &path)?;
        complete(&report, settings.last_tick() + 1)?;
        Ok(Flown { report, settings })
    }
}

fn complete(report: &Report, requested_ticks: u64) -> Result<(), Failure> {
    let ticks = report.ticks.run + report.ticks.skipped;
    if ticks == requested_ticks && !report.run.in_flight {
        return Ok(());
    }
    let ending = &report.run.ending;
    Err(Failure::failed(format!(
        "a flight of {requested_ticks} ticks ended after {ticks}: {ending}"
    )))
}

pub fn series<'a>(report: &'a Report, name: &str) -> Result<&'a Statistics, Failure> {
    let missing = || Failure::failed(format!("the flight's report has no series `{name}`"));
    report.series(name).ok_or_else(missing)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    /// Runs a shell script in place of ironbird; `$OUT` is the directory for its flight.
    fn flights(script: &str) -> FlightRunner {
        let mut flights = FlightRunner::new().unwrap();
        flights.executable = flights.directory.path().join("script");
        let script = format!("#!/bin/sh\nfor OUT; do :; done\n{script}\n");
        fs::write(&flights.executable, script).unwrap();
        fs::set_permissions(&flights.executable, fs::Permissions::from_mode(0o755)).unwrap();
        flights
    }

    #[test]
    fn a_failed_flight_is_no_measurement_whatever_its_directory_contains() {
        for code in [1, 2, 4, 5, 130] {
            let report = "mkdir -p $OUT/latest; echo '{}' > $OUT/latest/report.json";
            let flights = flights(&format!("{report}; echo why >&2; exit {code}"));
            let error = flights.fly(&[]).unwrap_err().to_string();
            let words = format!("a flight ended with exit status: {code}: why");
            assert!(error.contains(&words), "{error}");
        }
        let error = flights("exit 0").fly(&[]).unwrap_err().to_string();
        for words in ["report.json: No such file", "ended with exit status: 0"] {
            assert!(error.contains(words), "{error}");
        }
    }
}
