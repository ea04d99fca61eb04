//! The final report in all its forms: JSON, terminal text, web page and picture.

use std::fs::File;
use std::path::Path;

use crate::page;
use crate::page::picture;
use crate::schema::Report;
use crate::text;
use failure::{Failure, InFile as _};

/// Writes report.json, report.txt, report.html, and flight.svg where the report has traces.
///
/// # Errors
/// [`Failure`] names the file that cannot be written.
pub fn write_all(report: &Report, directory: &Path) -> Result<(), Failure> {
    report.write(&directory.join("report.json"))?;
    let write = |name: &str, text: String| {
        let path = directory.join(name);
        std::fs::write(&path, text).in_file("write", &path)
    };
    write("report.txt", text::render(report))?;
    write("report.html", page::render(report))?;
    if let Some(traces) = &report.traces {
        let run = &report.run;
        let title = format!("{} with gains {}, {}", run.trajectory, run.preset, run.started);
        write("flight.svg", picture::render(traces, &report.swaps, run.period_us / 1e6, &title))?;
    }
    sync(directory);
    Ok(())
}

/// Has the report reach the medium: it is the last word on a flight. A disk that cannot be synced still has it.
fn sync(directory: &Path) {
    let report = File::open(directory.join("report.json")).and_then(|file| file.sync_all());
    let _ = report.and_then(|()| File::open(directory)?.sync_all());
}
