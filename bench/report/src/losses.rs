//! What of a flight was not recorded.
//!
//! The top of the report says so, and such a flight is never a plain PASS.

use std::collections::BTreeMap;

use crate::laws;
use crate::schema::{LogSection, Report};
use crate::text::count;
use flight_log::FILE;
use flight_log::facts::{AROUND_MISSES, OFF};

/// Messages that never reached the recorder.
#[must_use]
pub fn lost(report: &Report) -> u64 {
    sum(&report.recorder.lost)
}

/// Messages that reached the recorder, and not flight.mcap.
#[must_use]
pub fn unlogged(report: &Report) -> u64 {
    sum(&report.recorder.log.dropped)
}

/// A file may hold any numbers.
fn sum(counts: &BTreeMap<String, u64>) -> u64 {
    counts.values().fold(0, |sum, count| sum.saturating_add(*count))
}

/// What flight.mcap holds, and what it was not to hold.
#[must_use]
pub fn log(log: &LogSection) -> String {
    if log.kept == OFF {
        return "flight.mcap: none, as asked (recorder.log = off)".into();
    }
    let mut text = match log.files {
        0 | 1 => format!("{FILE}: "),
        files => format!("flight*.mcap: {files} files, "),
    };
    let megabytes = log.file_bytes as f64 / 1e6;
    text += &format!("{} in {megabytes:.1} MB, {} dropped", count(sum(&log.messages), "message"), sum(&log.dropped));
    text.extend(log.refused.iter().map(|reason| format!(" ({reason})")));
    if log.kept == AROUND_MISSES {
        text += &format!("; {} kept, {} left out as asked", count(log.stretches, "excerpt"), sum(&log.left_out));
    }
    let removed = sum(&log.removed);
    if removed > 0 {
        text += &format!("; {removed} in older files, removed as asked");
    }
    text
}

/// What is missing, and what laws could not say, a sentence each.
#[must_use]
pub fn sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    let (lost, unlogged) = (lost(report), unlogged(report));
    if lost > 0 {
        let log = &report.recorder.log;
        let all = [&log.messages, &log.dropped, &log.left_out, &log.removed].into_iter().map(sum);
        let all = all.fold(lost, u64::saturating_add);
        let of: Vec<String> =
            report.recorder.lost.iter().filter(|(_, n)| **n > 0).map(|(topic, n)| format!("{topic} {n}")).collect();
        // Without a log nobody has counted them.
        let of_all = if log.kept == OFF { String::new() } else { format!(" of {all}") };
        sentences.push(format!(
            "NOT WHOLE: {lost}{of_all} messages were lost before they were recorded ({}); no latency is known of them",
            of.join(", ")
        ));
    }
    if unlogged > 0 {
        let why = report.recorder.log.refused.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        sentences.push(format!("NOT WHOLE: flight.mcap lacks {unlogged} messages{why}"));
    }
    let unwritten = report.recorder.unwritten.iter();
    sentences.extend(unwritten.map(|(file, why)| format!("NOT WHOLE: {file} is incomplete: {why}")));
    sentences.extend(laws::sentences(&report.run, &report.series, &report.roles));
    sentences
}
