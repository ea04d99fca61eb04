//! Replays of the flights that commit c92f732 recorded have its hashes (golden/flights.txt), and are as in `snapshots/`:
//! `INSTA_UPDATE=always cargo test -p replay` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::Path;

use replay::fly_again;

#[test]
fn replays_are_identical_and_their_summaries_are_their_snapshot() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/tests/golden");
    let hashes = fs::read_to_string(golden.join("flights.txt")).unwrap();
    let mut text = String::new();
    for (flight, from) in [
        ("real-time", 0),
        ("swap", 0),
        ("swap", 150),
        ("message-faults", 0),
    ] {
        let log = golden.join(flight).join("flight.mcap");
        let replayed = fly_again(&log, from, false, &[]).unwrap();
        assert!(replayed.is_identical(), "{:?}", replayed.comparison);
        let (summary, survey) = (replayed.summary, replayed.survey);
        let has_hash =
            |line: &str| line.starts_with(flight) && line.contains(&summary.outputs.to_string());
        assert!(hashes.lines().any(has_hash), "{flight}");
        text += &format!(
            "{flight} from {from}\n{}{summary:?}\n",
            summary.text(&survey)
        );
        text += &format!("{:?} {:?}\n\n", replayed.comparison, survey.swaps);
    }
    insta::assert_snapshot!(text.replace(&*golden.to_string_lossy(), ""));
}
