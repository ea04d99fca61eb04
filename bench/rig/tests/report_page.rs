//! report.html as a browser shows it: complete, readable on a telephone and a desk, by day, by night and on paper.
//!
//! The browser is Chromium, named by `IRONBIRD_CHROMIUM` or found. Where there is none, what needs it is left out, and
//! says so.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod browser;
mod rig;

use std::fs;
use std::path::{Path, PathBuf};

use browser::Browser;
use report::page;
use report::schema::{LateStretchSection, Report, RunLength};
use report::tally::distribution::Bucket;
use rig::Rig;
use serde_json::Value;

const LOOK: &str = include_str!("browser/look.js");

/// Plots of every flight.
const PLOTS: [&str; 30] = [
    "roll",
    "pitch",
    "yaw",
    "x",
    "y",
    "z",
    "position-error",
    "rate-error",
    "distance",
    "thrust",
    "torque",
    "rotors",
    "i_r",
    "k_r",
    "delta",
    "i_r-error",
    "k_r-error",
    "delta-error",
    "path-xy",
    "path-xz",
    "path-yz",
    "waterfall-p50",
    "waterfall-p99",
    "loop",
    "curve-loop",
    "curve-hop",
    "curve-compute",
    "curve-busy",
    "v",
    "v-change",
];

/// Plots of a flight by the clock with late commands.
const LATE_PLOTS: [&str; 6] = ["wake", "curve-wake", "curve-period", "late", "late-histogram", "miss-runs"];

/// A word that nothing may break, and that would do harm where it is not escaped.
const HOSTILE: &str = "</title></svg><script>throw 1</script>\"'&<b>";

const SWAPS: [&str; 4] = ["--fault", "gyro_noise_rad_s=0.01@tick500", "--fault", "rotational_drag_nm_s=0.525@tick1000"];

/// A flight in lockstep with two swaps, one of which the theorem does not cover.
fn flight(rig: &Rig) -> PathBuf {
    rig.run("fly", &[&["--pace", "lockstep", "--duration", "2s"], &SWAPS[..]].concat()).expect(0);
    rig.out().join("latest")
}

/// The same by the clock, in slow motion, with the machine's floors beside.
fn slow_flight(rig: &Rig) -> PathBuf {
    let beside = ["--config", &rig.slow(2), "--duration", "2s", "--floor", "1s"];
    let ended = rig.run("fly", &[&beside[..], &SWAPS[..]].concat()).expect(0);
    ended.says("\nFloors    at p50, p99, p99.9: wake.plant is ").says("raw futex ring").says("bare timer");
    rig.out().join("latest")
}

/// A flight's report with all that a bad day adds: late commands, a refused step, hostile words.
fn bad_day(directory: &Path) -> Report {
    let mut report = Report::read(&directory.join("report.json")).unwrap();
    report.run.instance = HOSTILE.into();
    report.verdict.gates[0].value = HOSTILE.into();
    report.swaps[0].changes[0].name = HOSTILE.into();
    let step = report.roles.get_mut("plant").unwrap().realtime.first_mut();
    if let Some(step) = step {
        (step.granted, step.refused) = (false, Some(HOSTILE.into()));
    }
    let deadlines = &mut report.deadlines;
    let stretch = |i: u64| LateStretchSection {
        tick: 400 * i,
        time_s: 0.4 * i as f64,
        length_ticks: i,
        late_us: 30.0 * 7_f64.powi(i32::try_from(i).unwrap()),
    };
    deadlines.stretches = (1..=4).map(stretch).collect();
    deadlines.late = vec![Bucket { from_us: 200.0, below_us: 500.0, count: 7 }];
    deadlines.runs = vec![RunLength { length_ticks: 1, count: 3 }, RunLength { length_ticks: 400, count: 12_345 }];
    report
}

fn list(found: &Value) -> Vec<&str> {
    found.as_array().unwrap().iter().map(|value| value.as_str().unwrap()).collect()
}

/// Opens a page in all the ways it can be looked at; it must be whole and readable in each.
fn inspect(browser: &mut Browser, page: &Path, plots: &[&str]) {
    let mut grounds = Vec::new();
    for (width, scheme, medium) in [
        (1400, "light", "screen"),
        (1400, "dark", "screen"),
        (400, "light", "screen"),
        (400, "dark", "screen"),
        (960, "light", "screen"),
        (740, "dark", "print"),
    ] {
        let case = format!("{} at {width} pixels, {scheme}, {medium}", page.display());
        browser.show(page, width, scheme, medium);
        let seen = browser.evaluate(LOOK);
        assert_eq!(list(&seen["faults"]), Vec::<&str>::new(), "{case}");
        assert_eq!(browser.complaints(), Vec::<String>::new(), "{case}");
        assert_eq!(seen["scripts"], 0, "{case}");
        assert!(seen["texts"].as_u64().unwrap() > 300, "{case}: {} pieces of text", seen["texts"]);
        let drawn = list(&seen["plots"]);
        for plot in plots {
            assert_eq!(drawn.iter().filter(|name| *name == plot).count(), 1, "{plot} in {case}: {drawn:?}");
        }
        grounds.push(seen["ground"].clone());
    }
    assert_eq!((&grounds[0], &grounds[1]), (&grounds[2], &grounds[3]));
    assert_ne!(grounds[0], grounds[1], "day and night look the same");
}

#[test]
#[ignore = "long: part of the gate"]
fn the_page_is_whole_and_readable_by_day_by_night_and_on_paper() {
    let Some(mut browser) = Browser::open() else { return };
    let rig = Rig::new("page");
    let directory = flight(&rig);
    inspect(&mut browser, &directory.join("report.html"), &[&PLOTS[..], &["violations-gyro_noise"]].concat());

    let page = rig.path("bad.html");
    fs::write(&page, page::render(&bad_day(&slow_flight(&rig)))).unwrap();
    inspect(&mut browser, &page, &[&PLOTS[..], &LATE_PLOTS].concat());
    let text = browser.evaluate("document.body.innerText");
    assert!(text.as_str().unwrap().contains(HOSTILE), "hostile words are shown as they are");

    // What chromium prints.
    let pdf = browser.call("Page.printToPDF", &serde_json::json!({}));
    assert!(pdf["data"].as_str().unwrap().starts_with("JVBERi"), "a PDF in base 64");
}

#[test]
fn the_look_finds_what_is_wrong() {
    let Some(mut browser) = Browser::open() else { return };
    let rig = Rig::new("look");
    let page = rig.path("wrong.html");
    let wrong = r#"<!DOCTYPE html><html><head><style>body { background: #ffffff; margin: 0; }</style></head><body>
        <p style="white-space: nowrap">a line that is much too long for a telephone and cannot be broken anywhere</p>
        <p style="color: #dddddd">pale</p>
        <figure><svg role="img" aria-label="plot" viewBox="0 0 400 100" width="380">
        <text x="390" y="20">cut off</text><text x="10" y="50">one on</text><text x="12" y="51">another</text>
        <path class="line" d=""></path></svg></figure>
        <img src="https://example.invalid/x.png"><script>console.error("told")</script></body></html>"#;
    fs::write(&page, wrong).unwrap();
    browser.show(&page, 400, "light", "screen");
    let seen = browser.evaluate(LOOK);
    let faults = list(&seen["faults"]).join("\n");
    for fault in ["leaves the page", "is cut in plot", "overlaps", "a line of plot is empty", "contrast"] {
        assert!(faults.contains(fault), "no `{fault}` among\n{faults}");
    }
    let complaints = browser.complaints().join("\n");
    assert!(complaints.contains("told") && complaints.contains("example.invalid"), "{complaints}");
}

#[test]
fn the_page_is_made_of_report_json_alone() {
    let rig = Rig::new("json");
    let directory = flight(&rig);
    let written = fs::read_to_string(directory.join("report.html")).unwrap();
    assert_eq!(rig.run("report", &["--format", "html"]).expect(0).stdout, written);
    assert!(written.starts_with("<!DOCTYPE html>") && !written.contains("http://") && !written.contains("https://"));
    let hostile = page::render(&bad_day(&directory));
    assert!(!hostile.contains("<script") && !hostile.contains("throw 1</script>"), "words are escaped");
    // Small enough to be sent, and to be written without being noticed.
    for (file, most) in [("report.html", 1_500_000), ("report.json", 1_500_000), ("flight.svg", 300_000)] {
        let length = fs::metadata(directory.join(file)).unwrap().len();
        assert!(length < most, "{file} has {length} bytes");
    }
}
