//! What of a flight was not recorded.
//!
//! The top of the report says so, and such a flight is never a plain PASS.

use crate::schema::Report;

/// Status of a flight that held its gates as far as it was seen.
pub const INCOMPLETE: &str = "INCOMPLETE";

/// Messages that never reached the recorder.
#[must_use]
pub fn lost(report: &Report) -> u64 {
    report.recorder.lost.values().sum()
}

/// Messages that reached the recorder, and not flight.mcap.
#[must_use]
pub fn unlogged(report: &Report) -> u64 {
    report.recorder.log.dropped.values().sum()
}

/// What is missing, a sentence each.
#[must_use]
pub fn sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    let (lost, unlogged) = (lost(report), unlogged(report));
    if lost > 0 {
        let log = &report.recorder.log;
        let seen: u64 = log.messages.values().sum::<u64>() + unlogged;
        let of: Vec<String> =
            report.recorder.lost.iter().filter(|(_, n)| **n > 0).map(|(topic, n)| format!("{topic} {n}")).collect();
        sentences.push(format!(
            "NOT WHOLE: {lost} of {} messages were lost before they were recorded ({}); no latency is known of them",
            seen + lost,
            of.join(", ")
        ));
    }
    if unlogged > 0 {
        let why = report.recorder.log.refused.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        sentences.push(format!("NOT WHOLE: flight.mcap lacks {unlogged} messages{why}"));
    }
    let unwritten = report.recorder.unwritten.iter();
    sentences.extend(unwritten.map(|(file, why)| format!("NOT WHOLE: {file} is incomplete: {why}")));
    sentences
}
