//! The report that the recorder writes once a second: outages with their causes, and the verdicts at the end.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use analysis::schema::Report;

#[derive(Debug, Default)]
pub(super) struct FiledReport {
    /// The page of the report; none while the directory of the flight is unknown.
    pub(super) path: Option<PathBuf>,
    /// When the report was written that was read.
    written: Option<SystemTime>,
    pub(super) report: Option<Box<Report>>,
}

impl FiledReport {
    /// Reads the report in a flight's directory again, if it has changed.
    pub(super) fn look(&mut self, directory: &str, run_id: u64) {
        if directory.is_empty() {
            *self = Self::default();
            return;
        }
        let directory = Path::new(directory);
        self.path = Some(directory.join("report.html"));
        let path = directory.join("report.json");
        let written = fs::metadata(&path).and_then(|it| it.modified()).ok();
        if written != self.written {
            self.written = written;
            let read = fs::read(&path).ok();
            let report = read.and_then(|bytes| serde_json::from_slice::<Box<Report>>(&bytes).ok());
            self.report = report.filter(|it| it.run.run_id == run_id);
        }
    }

    /// The report of a flight that has ended.
    pub(super) fn complete(&self) -> Option<&Report> {
        self.report.as_deref().filter(|it| !it.run.in_flight)
    }
}
