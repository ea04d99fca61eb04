//! report.json, written whole, read again and checked for what no flight can have; and run.json.

use crate::host::Host;
use crate::json;
use crate::schema::{Report, SCHEMA};
use errors::{Failure, InFile as _, read_text};
use flight_log::build::Build;
use serde::{Deserialize, Serialize};
use serde_json::{Number, Value};
use std::path::Path;

/// run.json: the settings, build and host of a flight, enough to repeat it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFacts {
    pub version: String,
    /// The executable.
    pub build: Build,
    pub instance: String,
    pub settings: Value,
    pub host: Host,
}

impl RunFacts {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        serde_json::from_str(&read_text("read", path)?).in_file("read", path)
    }
}

impl Report {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        Self::of(&read_text("read the report", path)?, path)
    }

    /// The report of a text that is, or was to be, in a file.
    pub fn of(text: &str, path: &Path) -> Result<Self, Failure> {
        let mut value: Value = serde_json::from_str(text).in_file("read the report", path)?;
        let schema = value["schema"].as_str().unwrap_or("none");
        if schema != SCHEMA {
            let path = path.display();
            return Err(Failure::failed(format!(
                "{path} has the schema `{schema}`, this version reads `{SCHEMA}`"
            )));
        }
        if let Some(what) = repair(&mut value).first() {
            return Err(Failure::failed(format!(
                "cannot read the report {}: {what}",
                path.display()
            ))
            .help("it is not as ironbird wrote it; `ironbird export` reads the flight's log"));
        }
        serde_json::from_value(value).in_file("read the report", path)
    }

    /// The text of report.json.
    pub fn text(&self) -> serde_json::Result<String> {
        let mut value = serde_json::to_value(self)?;
        let wrong = repair(&mut value);
        let text = if wrong.is_empty() {
            json::to_string(self)
        } else {
            // What no flight has is 0 or empty, and named among what could not be written.
            let why = format!(
                "shared memory was overwritten: {}",
                wrong.join("; ").escape_default()
            );
            value["recorder"]["unwritten"]["report.json"] = why.into();
            json::to_string(&value)
        };
        Ok(text? + "\n")
    }
}

/// Replaces what no flight has by 0 or nothing, and names it: another process may have written anything over the shared
/// memory that numbers were taken from. Charts of such a number would have no scale, and a terminal might do what such a
/// text says.
fn repair(report: &mut Value) -> Vec<String> {
    let mut wrong = Vec::new();
    walk(report, String::new(), &mut wrong);
    wrong
}

fn walk(value: &mut Value, place: String, wrong: &mut Vec<String>) {
    /// The first wrong values are enough, and a file may have millions.
    const NAMED: usize = 20;
    const LARGEST: f64 = 1e30;
    /// Of ticks, counts and bytes, of which some are added up. The run's number and the epochs of processes are instants.
    const LARGEST_WHOLE: f64 = 1e15;
    // A number that a law showed of itself may be any, and its charts bear it.
    let is_telemetry = place.starts_with("run.laws.") && place.contains(".telemetry[")
        || place.starts_with("traces.telemetry.");
    let is_instant = place == "run.run_id" || place.ends_with(".epoch");
    let is_beyond = |number: &Number, most: f64| number.as_f64().is_none_or(|it| it.abs() > most);
    let what = match value {
        Value::Array(values) => {
            let places = values.iter_mut().enumerate();
            return places.for_each(|(i, it)| walk(it, format!("{place}[{i}]"), wrong));
        }
        Value::Object(keys) => {
            let dot = if place.is_empty() { "" } else { "." };
            let places = keys.iter_mut();
            return places.for_each(|(key, it)| walk(it, format!("{place}{dot}{key}"), wrong));
        }
        Value::Number(it) if !it.is_f64() && !is_instant => is_beyond(it, LARGEST_WHOLE)
            .then(|| format!("{place} = {it} is no count of a flight: allowed are those up to {LARGEST_WHOLE:e}")),
        Value::Number(it) => (is_beyond(it, LARGEST) && !(is_telemetry && it.as_f64().is_some()))
            .then(|| format!("{place} = {it} is no number of a flight: allowed are those up to {LARGEST:e}")),
        Value::String(text) => text.contains(char::is_control).then(|| {
            let text = text.escape_default();
            format!("{place} = \"{text}\" is no text of a flight: it has control characters")
        }),
        Value::Null | Value::Bool(_) => None,
    };
    if let Some(what) = what {
        *value = if value.is_string() {
            "".into()
        } else {
            0.into()
        };
        if wrong.len() < NAMED {
            wrong.push(what);
        }
    }
}
