//! What groups of flights differ in, and what the report says of status boards, is as in `snapshots/`: `INSTA_UPDATE=always
//! cargo test -p analysis` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::fs;
use std::path::{Path, PathBuf};

use analysis::diff::{ComparedRun, compare};
use analysis::schema::Report;
use analysis::sections::{redundancy, role_section};
use hashed::{figures, hashed};
use messages::blackboards::{RolePhase, Status};
use messages::channels::Redundancy;
use messages::layout::change_words;
use serde_json::{Value, json};

/// The figures that a person checks.
const DIFFERENCES: [(&str, &str); 5] = [
    ("/timing", "says differ judged largest reason"),
    ("/tracking", "says differ judged largest reason"),
    ("/a", "run status ticks missed not_fresh theorem"),
    ("/b", "run status ticks missed not_fresh theorem"),
    ("/figures", "name median_a median_b ratio probability says"),
];
const BOARDS: [(&str, &str); 7] = [
    (
        "/0",
        "active channels handovers mismatches first_mismatch_s longest_unprotected_ms",
    ),
    (
        "/0",
        "ticks_compared ticks_flown ticks_masked ticks_not_fresh ticks_outvoted ticks_unprotected",
    ),
    ("/0/differences", "a b"),
    ("/0/outages/0", "channel handover reason tick ticks time_s"),
    ("/0/switchovers", "from to reason tick command_step_rad_s"),
    (
        "/1",
        "landed scheduling ticks_run ticks_skipped ticks_stale usage",
    ),
    ("/1", "rejected realtime"),
];

fn recorded(flight: &str, file: &str) -> PathBuf {
    let reports = Path::new(env!("CARGO_MANIFEST_DIR")).join("../render/tests/reports");
    reports.join(flight).join(file)
}

/// Multiplies all numbers with a fraction.
fn scale(value: &mut Value, factor: f64) {
    match value {
        Value::Object(fields) => fields.values_mut().for_each(|it| scale(it, factor)),
        Value::Array(items) => items.iter_mut().for_each(|it| scale(it, factor)),
        Value::Number(number) if number.is_f64() => {
            *value = json!(number.as_f64().unwrap() * factor)
        }
        _ => {}
    }
}

#[test]
fn differences_of_groups_are_their_snapshot() {
    let directory = tempfile::tempdir().unwrap();
    let run = |flight: &str, factor: f64| {
        let read = |file| fs::read_to_string(recorded(flight, file)).unwrap();
        let mut report: Value = serde_json::from_str(&read("report.json")).unwrap();
        for part in ["series", "flight", "deadlines", "steal"] {
            scale(&mut report[part], factor);
        }
        let path = directory.path().join("report.json");
        fs::write(&path, report.to_string()).unwrap();
        ComparedRun {
            run: format!("{flight} {factor}"),
            report: Report::read(&path).unwrap(),
            facts: serde_json::from_str(&read("run.json")).unwrap(),
        }
    };
    let group = |flight: &str, factors: &[f64]| -> Vec<ComparedRun> {
        factors.iter().map(|factor| run(flight, *factor)).collect()
    };
    for (name, a, b) in [
        ("two", group("lockstep", &[1.0]), group("outages", &[1.0])),
        (
            "three",
            group("lockstep", &[1.0, 1.01, 1.02]),
            group("lockstep", &[1.3, 1.31, 1.33]),
        ),
        (
            "four",
            group("outages", &[1.0, 1.1, 1.2, 1.3]),
            group("outages", &[1.05, 1.15, 1.25, 1.28]),
        ),
    ] {
        let diff = compare(&a, &b);
        let text = serde_json::to_string_pretty(&diff).unwrap();
        let document = serde_json::to_value(&diff).unwrap();
        insta::assert_snapshot!(name, hashed(name, &text, &figures(&document, &DIFFERENCES)));
    }
}

#[test]
fn sections_of_status_boards_are_their_snapshot() {
    let (mut account, mut status) = (Redundancy::default(), Status::default());
    let mut small = (0..7_u64).cycle();
    let mut fill = |_: &_, _| small.next().unwrap_or_default();
    change_words(&mut account, &mut fill);
    change_words(&mut status, &mut fill);
    // Numbers with a fraction, and more outages than are kept.
    account.difference_max_rad_s = [1.5, 2.5, 3.5];
    account.difference_square_sum_rad2_s2 = [4.0, 9.0, 2.0];
    account.outage_count = 70;
    (account.channels, account.mismatches, account.first_mismatch) = (3, 2, 50);
    let mut landed = status;
    landed.phase = RolePhase::Landed as u64;
    let roles = [landed, status].map(|it| role_section(&it));
    let sections = json!([redundancy(&account, 2e-3), roles]);
    let text = analysis::json::to_string(&sections).unwrap();
    let shown = figures(&sections, &BOARDS);
    insta::assert_snapshot!("boards", hashed("boards", &text, &shown));
}
