//! The directories of a flight's recorders: one, and another for each that was started again.
//!
//! A second recorder does not write into the files of the first one: the states before it came are not known to it, and
//! what the first one wrote is whole up to its death.

use std::path::Path;

use analysis::gates::break_off;
use analysis::schema::{FlightStatus, Report};
use config::Settings;
use errors::Failure;
use recorder::run_directory::RunDirectory;
use render::files::write_all;

/// The directories, the first one's first.
pub(super) struct Recordings {
    pub(super) first: RunDirectory,
    pub(super) later: Vec<RunDirectory>,
    pub(super) settings: Settings,
    pub(super) instance: String,
}

impl Recordings {
    pub(super) fn newest(&self) -> &RunDirectory {
        self.later.last().unwrap_or(&self.first)
    }

    /// Makes a directory for another recorder.
    pub(super) fn begin_another(&mut self) -> Result<(), Failure> {
        let out = Path::new(&self.settings.recorder.out);
        self.later
            .push(RunDirectory::create(out, &self.settings, &self.instance)?);
        Ok(())
    }

    /// The last report and its directory, when the flight is over: the reports before it say where the flight goes on.
    pub(super) fn settle(&self) -> Result<(RunDirectory, Option<Report>), Failure> {
        let all = std::iter::once(&self.first).chain(&self.later);
        let all = all.map(|directory| Ok((directory, directory.report()?)));
        let mut all = all.collect::<Result<Vec<_>, Failure>>()?;
        let last = all.iter().rposition(|(_, report)| report.is_some());
        let (last, report) = all.remove(last.unwrap_or(0));
        let next = last.path.file_name().unwrap_or_default().to_string_lossy();
        for (directory, earlier) in all {
            if let Some(mut earlier) = earlier {
                let ending = format!(
                    "the recorder died; the flight went on, and another recorder wrote {next}"
                );
                break_off(&mut earlier, FlightStatus::Aborted, ending, "");
                write_all(&mut earlier, &directory.path);
            } else if directory.path != self.first.path {
                directory.discard();
            }
        }
        Ok((last.clone(), report))
    }
}
