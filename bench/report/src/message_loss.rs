//! Messages that were lost or not logged.
//!
//! The report begins with them, and the status of such a flight is INCOMPLETE at best.

use crate::laws;
use crate::schema::Report;
use flight_log::facts::OFF;
use std::collections::BTreeMap;

pub fn lost(report: &Report) -> u64 {
    sum(&report.recorder.lost)
}

pub fn unlogged(report: &Report) -> u64 {
    sum(&report.recorder.log.dropped)
}

pub fn sum(counts: &BTreeMap<String, u64>) -> u64 {
    counts.values().copied().fold(0, u64::saturating_add)
}

/// What is missing, and what laws could not say, a sentence each.
pub fn sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    let (lost, unlogged) = (lost(report), unlogged(report));
    if lost > 0 {
        let log = &report.recorder.log;
        let all = [&log.messages, &log.dropped, &log.left_out, &log.removed];
        let all = all.into_iter().map(sum).fold(lost, u64::saturating_add);
        let of = report.recorder.lost.iter().filter(|(_, n)| **n > 0);
        let of: Vec<String> = of.map(|(topic, n)| format!("{topic} {n}")).collect();
        // Without a log nobody has counted them.
        let of_all = match log.kept == OFF {
            true => String::new(),
            false => format!(" of {all}"),
        };
        sentences.push(format!(
            "INCOMPLETE RECORD: {lost}{of_all} messages were lost before they were recorded ({}); no latency is known of them",
            of.join(", ")
        ));
    }
    if unlogged > 0 {
        let why = report.recorder.log.refused.as_ref();
        let why = why.map(|why| format!(": {why}")).unwrap_or_default();
        let lacks = format!("flight.mcap lacks {unlogged} messages{why}");
        sentences.push(format!("INCOMPLETE RECORD: {lacks}"));
    }
    let unwritten = report.recorder.unwritten.iter();
    sentences.extend(
        unwritten.map(|(file, why)| format!("INCOMPLETE RECORD: {file} is incomplete: {why}")),
    );
    sentences.extend(laws::sentences(&report.run, &report.series, &report.roles));
    sentences
}
