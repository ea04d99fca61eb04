//! The launcher's status line on a terminal.
//!
//! It costs the same with and without a terminal, so a flight from a script is no different.

use std::fs;
use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use messages::blackboards::{Run, RunPhase};
use rustix::termios::tcgetwinsize;
use serde::Deserialize;

use crate::output::say;

pub(super) struct StatusLine {
    on_terminal: bool,
    duration_s: f64,
    figures: WatchedFigures,
}

impl StatusLine {
    pub(super) fn new(directory: &Path, duration_s: f64) -> Self {
        let figures = WatchedFigures {
            path: directory.join("report.json"),
            written: None,
            words: String::new(),
        };
        Self {
            on_terminal: io::stderr().is_terminal(),
            duration_s,
            figures,
        }
    }

    /// Shows how the flight goes, unless somebody else has the terminal.
    pub(super) fn show(&mut self, run: &Run, terminal_taken: bool) {
        self.figures.look();
        let line = match run.phase() {
            RunPhase::Mustering | RunPhase::Opening => {
                "waiting for all processes to be ready".into()
            }
            RunPhase::Closed => "landing".into(),
            RunPhase::Flying if run.tick == messages::content::NO_TICK => "armed".into(),
            RunPhase::Flying => self.flying(run),
        };
        if self.on_terminal && !terminal_taken {
            say(&format!("\r\x1b[K{}", cut(&line, columns())));
        }
    }

    fn flying(&self, run: &Run) -> String {
        let flown_s = run.flight_time_s(run.tick);
        format!(
            "{flown_s:7.1} of {:.1} s   missed {}   skipped {}   swaps {}{}",
            self.duration_s,
            run.deadlines_missed,
            run.ticks_skipped,
            run.parameter_epoch,
            self.figures.words
        )
    }

    pub(super) fn clear(&self) {
        if self.on_terminal {
            say("\r\x1b[K");
        }
    }
}

/// Columns of the terminal on standard error.
fn columns() -> usize {
    const UNKNOWN: usize = 80;
    let told = tcgetwinsize(io::stderr()).map(|size| usize::from(size.ws_col));
    // A line without a size, as of a serial port, tells 0.
    told.ok().filter(|columns| *columns > 0).unwrap_or(UNKNOWN)
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
struct WatchedFigures {
    path: PathBuf,
    /// When the report was written that has been read.
    written: Option<SystemTime>,
    words: String,
}

/// What the line shows of a report.
#[derive(Deserialize)]
struct EventLog {
    series: Vec<SeriesExcerpt>,
    flight: FlightExcerpt,
}

#[derive(Deserialize)]
struct SeriesExcerpt {
    name: String,
    p50_us: f64,
    p99_us: f64,
}

#[derive(Deserialize)]
struct FlightExcerpt {
    position_error_final_m: f64,
}

impl WatchedFigures {
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
        let Ok(EventLog { series, flight }) = serde_json::from_str(&text) else {
            return true;
        };
        let chain = series.iter().find(|series| series.name == "loop");
        let chain = chain
            .map(|chain| format!("   loop p50 {:.1} p99 {:.1} us", chain.p50_us, chain.p99_us));
        self.words = format!(
            "{}   error {:.3} m",
            chain.unwrap_or_default(),
            flight.position_error_final_m
        );
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_never_fills_its_terminal() {
        let line = "    1.0 of 30.0 s   missed 12   loop p99 678";
        assert_eq!(cut(line, 80), line);
        assert_eq!(
            cut(line, line.len()),
            "    1.0 of 30.0 s   missed 12",
            "half a number is another one"
        );
        assert_eq!(cut(line, 20), "    1.0 of 30.0 s");
        assert_eq!(cut(line, 8), "", "not even its first field has the room");
        assert_eq!(cut("armed", 80), "armed");
        assert_eq!(cut("armed", 1), "");
    }

    #[test]
    fn a_report_is_read_once_each_time_it_is_written() {
        let directory = tempfile::tempdir().unwrap();
        let mut line = StatusLine::new(directory.path(), 30.0);
        let figures = &mut line.figures;
        assert!(!figures.look());
        let write = |p50: f64, written: SystemTime| {
            let path = directory.path().join("report.json");
            let series = format!(
                "[{{\"name\": \"loop\", \"p50_us\": {p50}, \"p99_us\": 20, \"count\": 5}}]"
            );
            let text = format!(
                "{{\"series\": {series}, \"flight\": {{\"position_error_final_m\": 0.5}}}}"
            );
            fs::write(&path, text).unwrap();
            fs::File::options()
                .write(true)
                .open(path)
                .unwrap()
                .set_modified(written)
                .unwrap();
        };
        write(10.0, SystemTime::UNIX_EPOCH);
        assert_eq!(
            (figures.look(), figures.look(), figures.look()),
            (true, false, false)
        );
        assert_eq!(
            figures.words,
            "   loop p50 10.0 p99 20.0 us   error 0.500 m"
        );
        write(11.0, SystemTime::now());
        assert_eq!((figures.look(), figures.look()), (true, false));
        assert!(figures.words.contains("p50 11.0"), "{}", figures.words);
    }
}
