//! Messages that were lost or not logged.
//!
//! The report begins with them, and the status of such a flight is INCOMPLETE at best.

use crate::laws;
use crate::schema::Report;
use flight_log::facts::OFF;
use std::collections::BTreeMap;

/// Messages that never reached the recorder.
pub fn lost(report: &Report) -> u64 {
    sum(&report.recorder.lost)
}

/// Messages that reached the recorder, and not flight.mcap.
pub fn unlogged(report: &Report) -> u64 {
    sum(&report.recorder.log.dropped)
}

/// A file may hold any numbers.
pub fn sum(counts: &BTreeMap<String, u64>) -> u64 {
    counts
        .values()
        .fold(0, |sum, count| sum.saturating_add(*count))
}

/// What is missing, and what laws could not say, a sentence each.
pub fn sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    let (lost, unlogged) = (lost(report), unlogged(report));
    if lost > 0 {
        let log = &report.recorder.log;
        let all = [&log.messages, &log.dropped, &log.left_out, &log.removed]
            .into_iter()
            .map(sum);
        let all = all.fold(lost, u64::saturating_add);
        let of: Vec<String> = report
            .recorder
            .lost
            .iter()
            .filter(|(_, n)| **n > 0)
            .map(|(topic, n)| format!("{topic} {n}"))
            .collect();
        // Without a log nobody has counted them.
        let of_all = if log.kept == OFF {
            String::new()
        } else {
            format!(" of {all}")
        };
        sentences.push(format!(
            "INCOMPLETE RECORD: {lost}{of_all} messages were lost before they were recorded ({}); no latency is known of them",
            of.join(", ")
        ));
    }
    if unlogged > 0 {
        let why = report
            .recorder
            .log
            .refused
            .as_ref()
            .map_or_else(String::new, |why| format!(": {why}"));
        sentences.push(format!(
            "INCOMPLETE RECORD: flight.mcap lacks {unlogged} messages{why}"
        ));
    }
    let unwritten = report.recorder.unwritten.iter();
    sentences.extend(
        unwritten.map(|(file, why)| format!("INCOMPLETE RECORD: {file} is incomplete: {why}")),
    );
    sentences.extend(laws::sentences(&report.run, &report.series, &report.roles));
    sentences
}
