//! latency.hlog of a real flight, read by another implementation: the numbers of the report.
//!
//! The other implementation is the package `hdrhistogram` of PyPI (bench/rig/tests/requirements.txt), run by the
//! Python that `IRONBIRD_PYTHON` names. Where that is not set and `python3` has no such package, the comparison
//! is left out, and says so.

use report::schema::Report;
use report::series::Series;
use rustix::process::Signal;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

use crate::rig::{Rig, lacks_tool, send, wait_until};

/// Flies for two seconds; gives the flight's directory.
fn fly(place: &TempDir) -> PathBuf {
    let out = place.path().join("runs");
    let output = Command::new(env!("CARGO_BIN_EXE_ironbird"))
        .args([
            "fly",
            "--rt",
            "off",
            "--duration",
            "2s",
            "--instance",
            "hlog",
            "--out",
        ])
        .arg(&out)
        .current_dir(place.path())
        .env("IRONBIRD_ROOT", place.path().join("root"))
        .output()
        .unwrap();
    let directory = out.join("latest");
    assert!(
        directory.join("report.json").exists(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    directory
}

/// A line of the log that carries a histogram.
struct Interval {
    tag: String,
    start_s: f64,
    length_s: f64,
    max_ms: f64,
}

fn interval(line: &str) -> Option<Interval> {
    let mut fields = line.strip_prefix("Tag=")?.split(',');
    let tag = fields.next()?.to_owned();
    let mut number = || fields.next()?.parse().ok();
    let interval = Interval {
        tag,
        start_s: number()?,
        length_s: number()?,
        max_ms: number()?,
    };
    // Base 64 of a version 2 histogram, compressed.
    fields
        .next()
        .is_some_and(|payload| payload.starts_with("HISTFAAA") && fields.next().is_none())
        .then_some(interval)
}

/// The number of a comment such as `#[StartTime: 12.345 (seconds since epoch)]`.
fn header(log: &str, name: &str) -> f64 {
    let start = format!("#[{name}: ");
    let line = log
        .lines()
        .find_map(|line| line.strip_prefix(&start))
        .unwrap_or_else(|| panic!("no {name}: {log}"));
    line.trim_end_matches(']')
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap()
}

fn check_text(log: &str, report: &Report) {
    assert!(
        log.starts_with("#[ironbird: values in nanoseconds, a tag per series, intervals of 1 s]\n")
    );
    // The run is numbered when the roles are ready, and t_0 announced after that.
    let start_s = header(log, "StartTime");
    assert!(
        start_s >= report.run.run_id as f64 / 1e9 - 1e-3,
        "{start_s} is before the run"
    );
    assert_eq!(
        header(log, "BaseTime").to_bits(),
        start_s.to_bits(),
        "starts of intervals count from t_0"
    );
    assert_eq!(
        header(log, "MaxValueDivisor"),
        1e6,
        "maxima of intervals are in milliseconds"
    );

    let known: Vec<String> = Series::all().into_iter().map(Series::name).collect();
    let mut next_s: BTreeMap<String, f64> = BTreeMap::new();
    let mut max_us: BTreeMap<String, f64> = BTreeMap::new();
    for line in log.lines().filter(|line| !line.starts_with('#')) {
        let interval = interval(line).unwrap_or_else(|| panic!("not an interval: {line}"));
        assert!(known.contains(&interval.tag), "{}", interval.tag);
        let next_s = next_s.entry(interval.tag.clone()).or_default();
        assert!(
            interval.start_s >= *next_s && interval.start_s.fract() == 0.0,
            "{line}"
        );
        assert_eq!(interval.length_s, 1.0, "{line}");
        *next_s = interval.start_s + interval.length_s;
        let max_us = max_us.entry(interval.tag).or_default();
        *max_us = max_us.max(interval.max_ms * 1e3);
    }
    // On a busy machine the flight may leave its envelope before its second second.
    assert!(
        next_s["loop"] >= report.ticks.elapsed_s.min(1.0),
        "intervals up to the end: {next_s:?}"
    );
    let reported: Vec<&String> = report.series.iter().map(|series| &series.name).collect();
    assert!(
        reported.iter().all(|name| max_us.contains_key(*name)) && reported.len() == max_us.len(),
        "{reported:?}"
    );
    for (tag, max_us) in max_us {
        let expected = report.series(&tag).unwrap().max_us;
        // It is written with three decimals of a millisecond.
        assert!(
            (max_us - expected).abs() <= 0.5 + 1e-6,
            "{tag}: {max_us} us in the log, {expected} us in the report"
        );
    }
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

/// What the other implementation reads; `None` where there is none to be expected.
fn read_elsewhere(log: &Path) -> Option<Reading> {
    let named = std::env::var("IRONBIRD_PYTHON")
        .ok()
        .filter(|python| !python.is_empty());
    let python = named.as_deref().unwrap_or("python3");
    let has_package = Command::new(python)
        .args(["-c", "import hdrh.log"])
        .output()
        .is_ok_and(|o| o.status.success());
    if !has_package {
        let missing = format!(
            "{python} has no package hdrhistogram: pip install -r bench/rig/tests/requirements.txt"
        );
        assert!(named.is_none(), "IRONBIRD_PYTHON: {missing}");
        lacks_tool(&format!(
            "latency.hlog is not read by another implementation: {missing}"
        ));
        return None;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_hlog.py");
    let output = Command::new(python).arg(script).arg(log).output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

fn check_reading(reading: &Reading, log: &str, report: &Report) {
    assert_eq!(
        reading.start_s.to_bits(),
        header(log, "StartTime").to_bits()
    );
    let names: Vec<&String> = reading.tags.keys().collect();
    let mut reported: Vec<&String> = report.series.iter().map(|series| &series.name).collect();
    reported.sort();
    assert_eq!(names, reported);
    for series in &report.series {
        let read = &reading.tags[&series.name];
        assert_eq!(read.count, series.count, "values of {}", series.name);
        assert_eq!(
            read.intervals
                .iter()
                .map(|interval| interval.count)
                .sum::<u64>(),
            series.count
        );
        for (what, read_ns, reported_us) in [
            ("min", read.min_ns, series.min_us),
            ("p50", read.p50_ns, series.p50_us),
            ("p90", read.p90_ns, series.p90_us),
            ("p99", read.p99_ns, series.p99_us),
            ("max", read.max_ns, series.max_us),
        ] {
            // Both fill the same buckets, so that not even the precision of the histogram lies between them.
            let difference_us = (read_ns / 1e3 - reported_us).abs();
            assert!(
                difference_us < 1e-6,
                "{what} of {}: {read_ns} ns and {reported_us} us",
                series.name
            );
        }
        let highest_ns = read
            .intervals
            .iter()
            .map(|interval| interval.max_ns)
            .fold(0.0, f64::max);
        assert_eq!(highest_ns, read.max_ns, "{}", series.name);
        for interval in &read.intervals {
            assert!(
                interval.start_ms >= reading.start_s * 1e3 - 1.0
                    && interval.end_ms > interval.start_ms
            );
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn another_implementation_reads_the_numbers_of_the_report() {
    let place = tempfile::Builder::new()
        .prefix("ib-")
        .tempdir_in("/tmp")
        .unwrap();
    let directory = fly(&place);
    let report = Report::read(&directory.join("report.json")).unwrap();
    assert!(!report.run.in_flight);
    let path = directory.join("latency.hlog");
    let log = fs::read_to_string(&path).unwrap();
    check_text(&log, &report);
    if let Some(reading) = read_elsewhere(&path) {
        check_reading(&reading, &log, &report);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_recorder_leaves_whole_lines_up_to_its_last_second() {
    let rig = Rig::new("killed-hlog");
    let flight = rig.take_off(format!("--rt off --config {} --duration 1h", rig.slow(5)));
    let recorder = flight.roles()["record"];
    let directory = rig.out().join("latest");
    let report = directory.join("report.json");
    let elapsed_s = || Some(Report::read(&report).ok()?.ticks.elapsed_s);
    wait_until("three seconds", || {
        elapsed_s().filter(|elapsed_s| *elapsed_s > 3.5)
    });
    send(recorder, Signal::KILL);
    flight.end().expect(1);
    let path = directory.join("latency.hlog");
    let log = fs::read_to_string(&path).unwrap();
    assert!(log.ends_with('\n'), "its last line is cut");
    let lines: Vec<&str> = log.lines().filter(|line| !line.starts_with('#')).collect();
    let intervals: Vec<Interval> = lines
        .iter()
        .map(|line| interval(line).expect(line))
        .collect();
    assert!(
        intervals
            .iter()
            .any(|interval| interval.tag == "loop" && interval.start_s >= 2.0),
        "{}",
        lines.len()
    );
    if let Some(reading) = read_elsewhere(&path) {
        assert_eq!(
            reading
                .tags
                .values()
                .map(|tag| tag.intervals.len())
                .sum::<usize>(),
            lines.len()
        );
    }
}
