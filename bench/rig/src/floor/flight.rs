//! A flight of the rig as one side of a comparison: launched as a user does, read from its report.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use failure::Failure;
use machine::executable::own_executable;
use report::schema::Report;
use report::tally::series::Statistics;

/// Launches flights of an executable, one after the other.
#[derive(Debug)]
pub struct Hangar {
    executable: PathBuf,
    instance: String,
    /// Removed with everything in it.
    directory: tempfile::TempDir,
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
        Ok(Self { executable, instance: format!("floor-{}", std::process::id()), directory })
    }

    /// The executable.
    #[must_use]
    pub fn executable(&self) -> &std::path::Path {
        &self.executable
    }

    /// The instance that its flights are.
    #[must_use]
    pub fn instance(&self) -> &str {
        &self.instance
    }

    /// A place for temporary files.
    #[must_use]
    pub fn directory(&self) -> &std::path::Path {
        self.directory.path()
    }

    /// The command of a flight with these flags, and where its directory will be.
    #[must_use]
    pub fn command(&self, flags: &[&str]) -> (Command, PathBuf) {
        let out = self.directory.path().join("runs");
        let mut command = Command::new(&self.executable);
        command.arg("fly").args(flags).args(["--instance", &self.instance]).arg("--out").arg(&out);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        (command, out.join("latest"))
    }

    /// Flies, and gives the report.
    ///
    /// # Errors
    /// [`Failure`] where the flight cannot be launched or leaves no report, with what it complained of.
    pub fn fly(&self, flags: &[&str]) -> Result<Report, Failure> {
        let (mut command, run) = self.command(flags);
        let output = command.output().map_err(|e| Failure::failed(format!("cannot launch a flight: {e}")))?;
        let report = Report::read(&run.join("report.json"));
        let landed = report.as_ref().is_ok_and(|report| !report.run.in_flight);
        let complaint = String::from_utf8_lossy(&output.stderr);
        // A gate that does not hold is no reason to throw a measurement away.
        match report {
            Ok(report) if landed => Ok(report),
            _ => Err(Failure::failed(format!("a flight ended with {}: {}", output.status, complaint.trim()))),
        }
    }
}

/// A series of a report.
///
/// # Errors
/// [`Failure`] names the series that is not there.
pub fn series<'a>(report: &'a Report, name: &str) -> Result<&'a Statistics, Failure> {
    let found = report.series.iter().find(|series| series.name == name);
    found.ok_or_else(|| Failure::failed(format!("the flight's report has no series `{name}`")))
}
