//! The report as files: JSON, terminal text, web page and picture.

use crate::figures::Figures;
use crate::{flight, page, picture};
use analysis::gates::mark_incomplete;
use analysis::schema::Report;
use errors::write_whole;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;

const JSON: &str = "report.json";

/// Writes report.json, report.txt, report.html, and flight.svg where the report has traces. A file that cannot be written
/// is named in the report.
pub fn write_all(report: &mut Report, directory: &Path) {
    let known = report.recorder.unwritten.len();
    let json = report.text();
    write(report, directory, JSON, json);
    let mut texts = vec![
        ("report.txt", flight::text(report)),
        ("report.html", page::render(report)),
    ];
    if let Some(figures) = Figures::of(report) {
        let figures = Figures {
            late: &[],
            channel_outages: &[],
            ..figures
        };
        let picture = picture::render(&figures, &flight::title(&report.run));
        texts.push(("flight.svg", picture));
    }
    for (name, text) in texts {
        write(report, directory, name, Ok(text));
    }
    if report.recorder.unwritten.len() > known {
        let json = report.text();
        write(report, directory, JSON, json);
    }
}

fn write(report: &mut Report, directory: &Path, name: &str, text: serde_json::Result<String>) {
    let written = text.map_err(|e| e.to_string()).and_then(|text| {
        let write = |file: &mut File| file.write_all(text.as_bytes());
        write_whole(&directory.join(name), write)
    });
    if let Err(why) = written {
        report.recorder.unwritten.entry(name.into()).or_insert(why);
        mark_incomplete(report);
    }
}
