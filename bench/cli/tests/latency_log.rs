//! latency.hlog of a real flight, read by another implementation: the numbers of the report.
//!
//! The other implementation is the package `hdrhistogram` of PyPI (bench/cli/tests/requirements.txt), run by the
//! Python that `IRONBIRD_PYTHON` names. Where that is not set and `python3` has no such package, the comparison
//! is left out, and says so.

use serde::Deserialize;
use std::collections::BTreeMap;

use crate::python::{python_with, run_python};
use crate::rig::Rig;

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
    let Some(python) = python_with("hdrh.log", "latency.hlog is not read elsewhere") else {
        return;
    };
    let path = rig.out().join("latest/latency.hlog");
    let read = run_python(&python, "bench/cli/tests/read_hlog.py", &[&path]);
    let reading: Reading = serde_json::from_slice(&read).unwrap();
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
