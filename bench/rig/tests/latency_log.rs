//! latency.hlog of a real flight, read by another implementation: the numbers of the report.
//!
//! The other implementation is the package `hdrhistogram` of PyPI (bench/rig/tests/requirements.txt), run by the
//! Python that `IRONBIRD_PYTHON` names. Where that is not set and `python3` has no such package, the comparison
//! is left out, and says so.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::process::Command;

use crate::rig::{Rig, lacks_tool};

/// The number of a comment such as `#[StartTime: 12.345 (seconds since epoch)]`.
fn header(log: &str, name: &str) -> f64 {
    let (_, rest) = log.split_once(&format!("#[{name}: ")).unwrap();
    rest.split([' ', ']']).next().unwrap().parse().unwrap()
}

#[derive(Debug, Deserialize)]
struct Reading {
    start_s: f64,
    tags: BTreeMap<String, TagReading>,
}

#[derive(Debug, Deserialize)]
struct TagReading {
    count: u64,
    min_ns: f64,
    p50_ns: f64,
    p90_ns: f64,
    p99_ns: f64,
    max_ns: f64,
    intervals: Vec<IntervalReading>,
}

#[derive(Debug, Deserialize)]
struct IntervalReading {
    start_ms: f64,
    end_ms: f64,
    count: u64,
    max_ns: f64,
}

/// The reading of the other implementation for the newest flight; none where it is missing.
fn read_elsewhere(rig: &Rig) -> Option<Reading> {
    let named = std::env::var("IRONBIRD_PYTHON").unwrap_or_default();
    let python = if named.is_empty() { "python3" } else { &named };
    let import = Command::new(python)
        .args(["-c", "import hdrh.log"])
        .output();
    if !import.is_ok_and(|output| output.status.success()) {
        let missing = format!(
            "{python} has no package hdrhistogram: pip install -r bench/rig/tests/requirements.txt"
        );
        assert!(named.is_empty(), "IRONBIRD_PYTHON: {missing}");
        lacks_tool(&missing);
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/read_hlog.py");
    let log = rig.out().join("latest/latency.hlog");
    let output = Command::new(python).arg(script).arg(log).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    Some(serde_json::from_slice(&output.stdout).expect(&errors))
}

#[test]
#[ignore = "long: part of the gate"]
fn another_implementation_reads_the_numbers_of_the_report() {
    let rig = Rig::with_features("hlog");
    rig.run("fly", "--rt off --duration 2s");
    let (log, report) = (rig.flown("latency.hlog"), rig.final_report());
    assert!(
        log.starts_with("#[ironbird: values in nanoseconds, a tag per series, intervals of 1 s]\n")
    );
    // The run is numbered when the roles are ready, and t_0 announced after that; starts of intervals count from t_0.
    let start_s = header(&log, "StartTime");
    assert!(
        start_s >= report.run.run_id as f64 / 1e9 - 1e-3,
        "{start_s}"
    );
    assert_eq!(header(&log, "BaseTime").to_bits(), start_s.to_bits());
    // Maxima of intervals are in milliseconds.
    assert_eq!(header(&log, "MaxValueDivisor"), 1e6);
    let Some(reading) = read_elsewhere(&rig) else {
        return;
    };
    assert_eq!(reading.start_s.to_bits(), start_s.to_bits());
    assert_eq!(reading.tags.len(), report.series.len());
    for series in &report.series {
        let (name, read) = (&series.name, &reading.tags[&series.name]);
        let counts: u64 = read.intervals.iter().map(|it| it.count).sum();
        assert_eq!((read.count, counts), (series.count, series.count), "{name}");
        // Both fill the same buckets, so that not even the precision of the histogram lies between them.
        for (read_ns, reported_us) in [
            (read.min_ns, series.min_us),
            (read.p50_ns, series.p50_us),
            (read.p90_ns, series.p90_us),
            (read.p99_ns, series.p99_us),
            (read.max_ns, series.max_us),
        ] {
            let difference_us = (read_ns / 1e3 - reported_us).abs();
            assert!(
                difference_us < 1e-6,
                "{name}: {read_ns} ns, {reported_us} us"
            );
        }
        let maxima = read.intervals.iter().map(|it| it.max_ns);
        assert_eq!(maxima.fold(0.0, f64::max), read.max_ns, "{name}");
        for it in &read.intervals {
            assert!(it.start_ms >= start_s * 1e3 - 1.0 && it.end_ms > it.start_ms);
        }
    }
}
