//! The report as files: written in all its forms (JSON, terminal text, web page and picture), and read again.

use std::fs::File;
use std::path::Path;

use serde_json::Value;

use crate::json;
use crate::page;
use crate::page::picture;
use crate::schema::{Report, SCHEMA};
use crate::text;
use failure::{Failure, InFile as _, read_text};

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
        write(
            "flight.svg",
            picture::render(traces, &report.swaps, &report.faults, run.period_us / 1e6, &text::title(run)),
        )?;
    }
    sync(directory);
    Ok(())
}

/// Has the report reach the medium: it is the last word on a flight. A disk that cannot be synced still has it.
fn sync(directory: &Path) {
    let report = File::open(directory.join("report.json")).and_then(|file| file.sync_all());
    let _ = report.and_then(|()| File::open(directory)?.sync_all());
}

impl Report {
    /// Reads a report.
    ///
    /// # Errors
    /// [`Failure`] names the file, and the schema where it is another one.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text = read_text("read the report", path)?;
        let value: Value = serde_json::from_str(&text).in_file("read the report", path)?;
        let schema = value["schema"].as_str().unwrap_or("none");
        if schema != SCHEMA {
            return Err(Failure::failed(format!(
                "{} has the schema `{schema}`, this version reads `{SCHEMA}`",
                path.display()
            )));
        }
        if let Some(what) = implausible(&value, String::new()) {
            return Err(Failure::failed(format!("cannot read the report {}: {what}", path.display()))
                .help("it is not as ironbird wrote it; `ironbird export` reads the flight's log"));
        }
        serde_json::from_value(value).in_file("read the report", path)
    }

    /// Writes the report so that a reader finds the old one or the new one, never a part.
    ///
    /// # Errors
    /// [`Failure`] names the file.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let text = json::to_string(self).in_file("write", path)?;
        let draft = path.with_extension("json.draft");
        std::fs::write(&draft, text + "\n").in_file("write", &draft)?;
        std::fs::rename(&draft, path).in_file("write", path)
    }
}

/// Whether a place is that of a number that a law showed of itself: it may be any, and its charts bear it.
fn is_telemetry(place: &str) -> bool {
    place.starts_with("run.laws.") && place.contains(".telemetry[") || place.starts_with("traces.telemetry.")
}

/// The first value that no flight has, with its place: pictures of such a number would have no scale, and a terminal
/// might do what such a text says.
fn implausible(value: &Value, place: String) -> Option<String> {
    const LARGEST: f64 = 1e30;
    /// Of ticks, counts and bytes, of which some are added up; the run's number is a time.
    const LARGEST_WHOLE: f64 = 1e15;
    match value {
        Value::Number(number) if !number.is_f64() && place != "run.run_id" => number
            .as_f64()
            .is_none_or(|it| it.abs() > LARGEST_WHOLE)
            .then(|| format!("{place} = {number} is no count of a flight: allowed are those up to {LARGEST_WHOLE:e}")),
        Value::Number(number) => number
            .as_f64()
            .is_none_or(|it| it.abs() > LARGEST && !is_telemetry(&place))
            .then(|| format!("{place} = {number} is no number of a flight: allowed are those up to {LARGEST:e}")),
        Value::String(text) => text.contains(char::is_control).then(|| {
            format!("{place} = \"{}\" is no text of a flight: it has control characters", text.escape_default())
        }),
        Value::Array(values) => values.iter().enumerate().find_map(|(i, it)| implausible(it, format!("{place}[{i}]"))),
        Value::Object(keys) => {
            let dot = if place.is_empty() { "" } else { "." };
            keys.iter().find_map(|(key, it)| implausible(it, format!("{place}{dot}{key}")))
        }
        Value::Null | Value::Bool(_) => None,
    }
}
