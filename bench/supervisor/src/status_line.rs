//! The launcher's status line on a terminal, and its messages, which wait while the dashboard has the terminal.
//!
//! It costs the same with and without a terminal, so a flight from a script is no different.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use messages::blackboards::{Run, RunPhase};
use rustix::termios::tcgetwinsize;
use serde_json::Value;

use errors::output::{has_screen, say};

pub(super) struct StatusLine {
    on_terminal: bool,
    /// Messages that wait for the dashboard to leave the terminal; none while it has not got it.
    waiting: Option<String>,
    duration_s: f64,
    figures: ReportFigures,
}

impl StatusLine {
    pub(super) fn new(directory: &Path, duration_s: f64) -> Self {
        Self {
            on_terminal: has_screen(&io::stderr()),
            waiting: None,
            duration_s,
            figures: ReportFigures::of(directory),
        }
    }

    /// Shows the figures of a new recorder, which writes into this directory.
    pub(super) fn follow(&mut self, directory: &Path) {
        self.figures = ReportFigures::of(directory);
    }

    /// Notes whether the dashboard has the terminal; prints what waited for it to leave.
    pub(super) fn set_taken(&mut self, is_taken: bool) {
        if is_taken {
            self.waiting.get_or_insert_default();
        } else if let Some(waiting) = self.waiting.take() {
            say(&waiting);
        }
    }

    /// Prints a message in a line of its own, or when the terminal is free.
    pub(super) fn tell(&mut self, message: &str) {
        self.clear();
        match &mut self.waiting {
            Some(waiting) => *waiting += &format!("{message}\n"),
            None => say(&format!("{message}\n")),
        }
    }

    /// Shows how the flight goes, unless the dashboard has the terminal.
    pub(super) fn show(&mut self, run: &Run) {
        self.figures.look();
        let line = match run.phase() {
            RunPhase::Mustering | RunPhase::Opening => {
                "waiting for all processes to be ready".into()
            }
            RunPhase::Closed => "landing".into(),
            RunPhase::Flying if run.tick == messages::content::NO_TICK => "armed".into(),
            RunPhase::Flying => self.flying(run),
        };
        if self.on_terminal && self.waiting.is_none() {
            say(&format!("\r\x1b[K{}", cut(&line, columns())));
        }
    }

    fn flying(&self, run: &Run) -> String {
        let flown_s = run.flight_time_s(run.tick);
        format!(
            "{flown_s:7.1} of {:.1} s   missed {}   skipped {}   changes {}{}",
            self.duration_s,
            run.deadlines_missed,
            run.ticks_skipped,
            run.parameter_epoch,
            self.figures.text
        )
    }

    pub(super) fn clear(&self) {
        if self.on_terminal && self.waiting.is_none() {
            say("\r\x1b[K");
        }
    }
}

/// Columns of the terminal on standard error.
fn columns() -> usize {
    const UNKNOWN: usize = 80;
    let size = tcgetwinsize(io::stderr()).map(|size| usize::from(size.ws_col));
    // A line without a size, as of a serial port, tells 0.
    size.ok().filter(|columns| *columns > 0).unwrap_or(UNKNOWN)
}

/// The fields of a line that do not wrap: one that does cannot be taken off the terminal again, and half a number is
/// another one.
fn cut(line: &str, columns: usize) -> String {
    let mut kept = line;
    while kept.chars().count() >= columns {
        match kept.rsplit_once("   ") {
            Some((before, _)) => kept = before.trim_end(),
            None => return kept.chars().take(columns - 1).collect(),
        }
    }
    kept.to_owned()
}

/// Figures of the recorder's report, which it writes anew once a second.
struct ReportFigures {
    path: PathBuf,
    /// When the report was written that has been read.
    written: Option<SystemTime>,
    text: String,
}

impl ReportFigures {
    fn of(directory: &Path) -> Self {
        Self {
            path: directory.join("report.json"),
            written: None,
            text: String::new(),
        }
    }

    /// Reads the report where it is another one than at the last look; says whether it was.
    fn look(&mut self) -> bool {
        let written = fs::metadata(&self.path)
            .and_then(|file| file.modified())
            .ok();
        if written.is_none() || written == self.written {
            return false;
        }
        self.written = written;
        // A flight does not depend on its status line.
        let text = fs::read_to_string(&self.path).unwrap_or_default();
        let report: Value = serde_json::from_str(&text).unwrap_or_default();
        if let Some(error_m) = report["flight"]["position_error_final_m"].as_f64() {
            self.text.clear();
            let mut series = report["series"].as_array().into_iter().flatten();
            if let Some(chain) = series.find(|series| series["name"] == "loop") {
                let [p50_us, p99_us] = ["p50_us", "p99_us"].map(|it| chain[it].as_f64());
                let [p50_us, p99_us] = [p50_us, p99_us].map(Option::unwrap_or_default);
                self.text += &format!("   loop p50 {p50_us:.1} p99 {p99_us:.1} us");
            }
            self.text += &format!("   error {error_m:.3} m");
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_never_fills_its_terminal() {
        let line = "    1.0 of 30.0 s   missed 12   loop p99 678";
        for (line, columns, expected) in [
            (line, 80, line),
            // Half a number is another one.
            (line, line.len(), "    1.0 of 30.0 s   missed 12"),
            (line, 20, "    1.0 of 30.0 s"),
            (line, 8, ""),
            ("armed", 80, "armed"),
            ("armed", 1, ""),
        ] {
            assert_eq!(cut(line, columns), expected, "{columns}");
        }
    }

    #[test]
    fn a_report_is_read_once_each_time_it_is_written() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("report.json");
        let mut figures = StatusLine::new(directory.path(), 30.0).figures;
        assert!(!figures.look());
        for (p50_us, written) in [(10, SystemTime::UNIX_EPOCH), (11, SystemTime::now())] {
            let text = format!(
                "{{\"series\": [{{\"name\": \"loop\", \"p50_us\": {p50_us}, \"p99_us\": 20, \"count\": 5}}], \
                 \"flight\": {{\"position_error_final_m\": 0.5}}}}"
            );
            fs::write(&path, text).unwrap();
            let file = fs::File::options().write(true).open(&path).unwrap();
            file.set_modified(written).unwrap();
            assert_eq!((figures.look(), figures.look()), (true, false));
            let expected = format!("   loop p50 {p50_us}.0 p99 20.0 us   error 0.500 m");
            assert_eq!(figures.text, expected);
        }
    }
}
