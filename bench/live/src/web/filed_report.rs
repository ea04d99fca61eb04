//! The report that the recorder writes once a second: outages with their causes, and the verdicts at the end.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use analysis::outages::OutageSection;
use analysis::schema::{AcceptanceResult, Verdicts};
use serde::Deserialize;

/// The part of report.json that the page shows.
#[derive(Debug, Deserialize)]
pub(super) struct Excerpt {
    pub(super) run: RunExcerpt,
    pub(super) words: Verdicts,
    pub(super) verdict: AcceptanceResult,
    pub(super) autopsy: OutageSection,
}

#[derive(Debug, Deserialize)]
pub(super) struct RunExcerpt {
    run_id: u64,
    pub(super) ending: String,
    pub(super) in_flight: bool,
}

#[derive(Debug, Default)]
pub(super) struct FiledReport {
    /// The page of the report; none while the directory of the flight is unknown.
    pub(super) path: Option<PathBuf>,
    /// When the report was written that was read.
    written: Option<SystemTime>,
    pub(super) excerpt: Option<Excerpt>,
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
            let excerpt = read.and_then(|bytes| serde_json::from_slice::<Excerpt>(&bytes).ok());
            self.excerpt = excerpt.filter(|it| it.run.run_id == run_id);
        }
    }
}
