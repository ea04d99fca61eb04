//! The reports of two recorded flights, and their comparison, are as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! render` accepts a change.
//!
//! `reports/` holds report.json, without most points of the plots, and run.json of
//! * `outages`: `fly --duration 400ms --rt off --on-death restart --outer estimating --fault inner.stop=20ms@100ms --fault
//!   mass_kg=0.6~50ms@180ms --fault state.drop=0.2@200ms..240ms --fault mixer.kill@280ms --gate theorem --max-miss-rate 10
//!   --max-tracking-error 0.1`,
//! * `lockstep`: `fly --pace lockstep --duration 300ms --inner indi --airframe crazyflie --fault mass_kg=+10%@100ms`.

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
    let of_both = ["brief.txt", "report.txt"];
    let more = ["flight.svg", "junit.xml", "report.html"];
    for (name, more) in [("outages", &more[..]), ("lockstep", &[])] {
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
        for file in of_both.iter().chain(more) {
            let text = fs::read_to_string(written.path().join(file)).unwrap();
            // One element a line, without the scripts and styles that are files of their own.
            let text = text
                .replace(include_str!("../src/page.css"), "")
                .replace(include_str!("../src/plot.css"), "")
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
