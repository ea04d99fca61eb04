//! The report as files: JSON, terminal text, web page and picture.

use crate::figures::Figures;
use crate::{flight, picture};
use analysis::schema::Report;
use errors::{Failure, InFile as _};
use std::fs::File;
use std::path::Path;

/// Writes report.json, report.txt, report.html, and flight.svg where the report has traces.
pub fn write_all(report: &Report, directory: &Path) -> Result<(), Failure> {
    report.write(&directory.join("report.json"))?;
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        std::fs::write(&path, text).in_file("write", &path)
    };
    write("report.txt", flight::text(report))?;
    write("report.html", flight::page(report))?;
    if let Some(figures) = Figures::of(report) {
        let figures = Figures {
            late: &[],
            ..figures
        };
        let picture = picture::render(&figures, &flight::title(&report.run));
        write("flight.svg", picture)?;
    }
    sync(directory);
    Ok(())
}

/// Has the report reach the medium: it is the last word on a flight. A disk that cannot be synced still has it.
fn sync(directory: &Path) {
    let report = File::open(directory.join("report.json")).and_then(|file| file.sync_all());
    let _ = report.and_then(|()| File::open(directory)?.sync_all());
}
