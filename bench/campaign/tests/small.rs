//! What a campaign draws, its rows with made-up outcomes, and their report are as in `snapshots/`: `INSTA_UPDATE=always
//! cargo test -p campaign` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::fs;
use std::path::Path;

use campaign::chunk::{self, Identity, Rows, State};
use campaign::gates::Outcome;
use campaign::results_document::document;
use campaign::table::{Row, Table};
use campaign::{aggregate, file};
use hashed::{figures, hashed};

/// The figures that a person checks.
const RESULTS: [(&str, &str); 8] = [
    ("", "name campaign flights planned intervals"),
    ("/arms", "name flights successes interval lost"),
    ("/arms/0/gates", "name held asked"),
    ("/arms/0/metrics", "name count mean max quantiles"),
    (
        "/pairs",
        "first second discordant p_value difference/mean difference/low",
    ),
    ("/pairs/0/metrics", "name count mean low high"),
    ("/factors", "name meaning"),
    ("/factors/0/arms", "of_success of_error bins"),
];

/// Errors that are spread over the flights; some are lost, some did not recover, one arm has no signal.
fn outcome(flight: u64, arm: usize) -> Outcome {
    let share = (flight * 7 + arm as u64 * 3) % 11;
    let value = |place: usize| 0.05 * (1 + share) as f64 * (1 + place % 3) as f64;
    Outcome {
        is_faulted: true,
        lost: (share == 10).then(|| "too far from the reference".into()),
        metrics: std::array::from_fn(|place| (place != 4 || share < 8).then_some(value(place))),
        telemetry: vec![(arm == 0).then_some([0.01, 0.06 * share as f64])],
        outputs: format!("{share:016x}"),
    }
}

#[test]
fn draws_rows_and_report_are_their_snapshots_and_a_flipped_bit_is_noticed() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/tests/campaigns/small.toml");
    let campaign = file::read(&fs::read_to_string(file).unwrap()).unwrap();
    let identity = Identity {
        name: campaign.name.clone(),
        campaign: campaign.fingerprint(&["first".into(), "second".into()]),
        build: "one".into(),
    };
    let directory = tempfile::tempdir().unwrap();
    let (mut text, mut all) = (format!("{campaign:#?}\n{identity:#?}\n"), Vec::new());
    for chunk in 0..campaign.chunks() {
        let mut rows = Vec::new();
        for flight in campaign.flights_of(chunk) {
            for (arm, named) in campaign.arms.iter().enumerate() {
                let draws = campaign.draws(flight);
                text += &format!("{flight} {}\n", campaign.given(named, &draws));
                let outcome = outcome(flight, arm);
                rows.push(Row {
                    flight,
                    arm,
                    draws,
                    outcome,
                });
            }
        }
        let (directory, identity) = (directory.path(), &identity);
        assert_eq!(
            chunk::state(directory, &campaign, identity, chunk),
            State::Missing
        );
        chunk::write(directory, &campaign, identity, chunk, &rows).unwrap();
        assert_eq!(
            chunk::state(directory, &campaign, identity, chunk),
            State::Whole
        );
        all.extend(rows);
    }
    // The first flight, of both arms: enough to see which parameters are drawn, and how far.
    let first = text.split_once("\n1 ").unwrap().0;
    let first = &first[first.find("\n0 ").unwrap() + 1..];
    insta::assert_snapshot!("draws", hashed("draws", &text, first));
    let table = Table::new(&campaign, &all);
    let mut text = table.rows_sha256() + "\n";
    for column in &table.columns {
        let cells = column
            .cells
            .iter()
            .map(|cell| cell.as_ref().map(ToString::to_string));
        let cells: Vec<String> = cells.map(Option::unwrap_or_default).collect();
        text += &format!(
            "{} [{}] {}: {}\n",
            column.name,
            column.unit,
            column.meaning,
            cells.join(",")
        );
    }
    insta::assert_snapshot!("rows", text);
    let rows = Rows::new(directory.path(), 0..campaign.chunks());
    let results = aggregate::of(&campaign, &identity, &rows).unwrap();
    let text = analysis::json::to_string(&results).unwrap();
    let shown = figures(&serde_json::from_str(&text).unwrap(), &RESULTS);
    insta::assert_snapshot!("results", hashed("results", &text, &shown));
    let document = document(&results, "small");
    let page = document.html().replace("><", ">\n<");
    let report = hashed("report.html", &page, &document.text());
    insta::assert_snapshot!("report", report);
    let merged = rows.merge(&campaign, &identity, &directory.path().join("all.parquet"));
    assert_eq!(merged.unwrap(), all.len() as u64);
    // A flipped bit is noticed in any eleventh byte, and a missing last byte.
    let path = chunk::path_of(directory.path(), 0);
    let whole = fs::read(&path).unwrap();
    let is_refused = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let state = chunk::state(directory.path(), &campaign, &identity, 0);
        matches!(state, State::Refused(_))
    };
    for (i, byte) in whole.iter().enumerate().step_by(11) {
        let mut flipped = whole.clone();
        flipped[i] = byte ^ (1 << (i % 8));
        assert!(is_refused(&flipped), "byte {i}");
    }
    assert!(is_refused(&whole[..whole.len() - 1]));
}
