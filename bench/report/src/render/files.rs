//! The report as files: written in all its forms (JSON, terminal text, web page and picture), and read again.

use crate::json;
use crate::render::figures::Figures;
use crate::render::{flight, picture};
use crate::schema::{Report, SCHEMA};
use errors::{Failure, InFile as _, read_text};
use serde_json::Value;
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
        write(
            "flight.svg",
            picture::render(&figures, &flight::title(&report.run)),
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
            return Err(Failure::failed(format!(
                "cannot read the report {}: {what}",
                path.display()
            ))
            .help("it is not as ironbird wrote it; `ironbird export` reads the flight's log"));
        }
        serde_json::from_value(value).in_file("read the report", path)
    }

    /// Writes the report so that a reader finds the old one or the new one, never a part.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let value = serde_json::to_value(self).in_file("write", path)?;
        let text = match implausible(&value, String::new()) {
            None => json::to_string(self),
            Some(_) => json::to_string(&repaired(value)),
        };
        let text = text.in_file("write", path)?;
        let draft = path.with_extension("json.draft");
        std::fs::write(&draft, text + "\n").in_file("write", &draft)?;
        std::fs::rename(&draft, path).in_file("write", path)
    }
}

/// A report that can be read again: another process may have written anything over the shared memory that numbers
/// were taken from. What no flight has is 0 or empty, and named among what could not be written.
fn repaired(mut report: Value) -> Value {
    let mut wrong = Vec::new();
    repair(&mut report, String::new(), &mut wrong);
    report["recorder"]["unwritten"]["report.json"] =
        format!("shared memory was overwritten: {}", wrong.join("; ")).into();
    report
}

fn repair(value: &mut Value, place: String, wrong: &mut Vec<String>) {
    match value {
        Value::Array(values) => {
            for (i, it) in values.iter_mut().enumerate() {
                repair(it, format!("{place}[{i}]"), wrong);
            }
        }
        Value::Object(keys) => {
            let dot = if place.is_empty() { "" } else { "." };
            for (key, it) in keys {
                repair(it, format!("{place}{dot}{key}"), wrong);
            }
        }
        leaf => {
            if let Some(what) = implausible(leaf, place) {
                *leaf = if leaf.is_string() {
                    "".into()
                } else {
                    0.into()
                };
                // As text it goes into the report.
                wrong.push(what.escape_default().to_string());
            }
        }
    }
}

/// Whether a place is that of a number that a law showed of itself: it may be any, and its charts bear it.
fn is_telemetry(place: &str) -> bool {
    place.starts_with("run.laws.") && place.contains(".telemetry[")
        || place.starts_with("traces.telemetry.")
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn numbers_that_no_flight_has_do_not_make_a_report_unreadable() {
        let written = repaired(json!({
            "lead": {"rehearsals": u64::MAX, "timer": 7},
            "roles": [{"text": "a\u{1b}b"}],
            "recorder": {"unwritten": {}},
        }));
        assert_eq!(implausible(&written, String::new()), None);
        assert_eq!(written["lead"], json!({"rehearsals": 0, "timer": 7}));
        let why = written["recorder"]["unwritten"]["report.json"]
            .as_str()
            .unwrap();
        assert!(
            why.contains("lead.rehearsals = 18446744073709551615") && why.contains("roles[0].text"),
            "{why}"
        );
    }
}
