//! The report of two recorded flights, and their comparison, are as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! render` accepts a change.
//!
//! The flights are in `reports/`, with every twelfth point of their plots: one with outages, a restart, a parameter change,
//! lost messages and gates that failed, and one in lockstep.

use std::fs;
use std::path::{Path, PathBuf};

use analysis::diff::{ComparedRun, compare};
use analysis::schema::Report;
use render::brief::Left;
use render::{brief, diff, files, flight, junit};

fn recorded(flight: &str, file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/reports")
        .join(flight)
        .join(file)
}

#[test]
fn reports_are_their_snapshots() {
    for name in ["outages", "lockstep"] {
        let report = Report::read(&recorded(name, "report.json")).unwrap();
        let written = tempfile::tempdir().unwrap();
        files::write_all(&report, written.path()).unwrap();
        junit::write(&report, &written.path().join("junit.xml")).unwrap();
        let left = Left {
            page: Some("report.html".into()),
            log: None,
        };
        let summary = brief::render(&report, &left) + &flight::result_line(&report, name);
        fs::write(written.path().join("brief.txt"), summary).unwrap();
        for file in [
            "brief.txt",
            "flight.svg",
            "junit.xml",
            "report.html",
            "report.txt",
        ] {
            let text = fs::read_to_string(written.path().join(file)).unwrap();
            // One element a line, without the scripts and styles that are files of their own.
            let text = text
                .replace(include_str!("../src/page.css"), "")
                .replace(include_str!("../src/readout.js"), "")
                .replace("><", ">\n<");
            insta::assert_snapshot!(format!("{name}.{file}"), text);
        }
    }
}

#[test]
fn the_comparison_of_two_flights_is_its_snapshot() {
    let [a, b] = ["lockstep", "outages"].map(|flight| ComparedRun {
        run: flight.into(),
        report: Report::read(&recorded(flight, "report.json")).unwrap(),
        facts: serde_json::from_str(&fs::read_to_string(recorded(flight, "run.json")).unwrap())
            .unwrap(),
    });
    insta::assert_snapshot!(diff::render(&compare(&[a], &[b])));
}
