//! `ironbird report diff` on real flights.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod rig;

use std::fs;

use rig::Rig;
use serde_json::Value;

const LOCKSTEP: [&str; 4] = ["--pace", "lockstep", "--duration", "1500ms"];

/// Two flights: their names.
fn two(rig: &Rig, second: &[&str]) -> [String; 2] {
    rig.run("fly", &LOCKSTEP).expect(0);
    rig.run("fly", &[&LOCKSTEP[..], second].concat()).expect(0);
    rig.run_directories().try_into().unwrap()
}

fn diff(rig: &Rig, a: &str, b: &str) -> Value {
    rig.run("report", &["diff", a, b, "--format", "json"]).expect(0).json()
}

#[test]
fn a_flight_against_itself_shows_no_difference() {
    let rig = Rig::new("same");
    rig.run("fly", &LOCKSTEP).expect(0);
    let diff = diff(&rig, "latest", "latest");
    assert_eq!((&diff["settings"], &diff["machine"]), (&Value::Array(vec![]), &Value::Array(vec![])));
    assert_eq!(diff["ratios_apart"], 0);
    assert!(diff["ratios"].as_u64().unwrap() > 20, "{diff}");
    for series in diff["series"].as_array().unwrap() {
        let [p50, .., p999, p9999] = &series["percentiles"].as_array().unwrap()[..] else { panic!("{series}") };
        assert_eq!((&p50["ratio"], &p50["says"]), (&1.0.into(), &"within_the_spread".into()), "{series}");
        assert!(p50["ratio_low"].as_f64().unwrap() <= 1.0 && 1.0 <= p50["ratio_high"].as_f64().unwrap());
        // 1501 ticks say nothing about one in a thousand.
        for rare in [p999, p9999] {
            assert_eq!((&rare["ratio"], &rare["says"]), (&Value::Null, &"too_few_values".into()), "{series}");
        }
    }
}

#[test]
fn other_settings_and_machines_are_named() {
    let rig = Rig::new("other");
    let [a, b] = two(&rig, &["--trajectory", "hover"]);
    let facts = rig.out().join(&b).join("run.json");
    let text = fs::read_to_string(&facts).unwrap();
    let clock = text.lines().find(|line| line.contains("\"clock_source\"")).unwrap();
    fs::write(&facts, text.replace(clock, "\"clock_source\": \"sundial\",")).unwrap();
    let text = rig.run("report", &["diff", &a, &b]).expect(0).stdout;
    for words in [
        "flight.trajectory: lissajous | hover",
        "| sundial",
        "The flights had different settings.",
        "Machine or granted scheduling differ.",
        "too few values: 1500, p99.9 needs 10000",
        "A did not fly at the speed of the clock",
        "Believe a difference that repeated flights",
    ] {
        assert!(text.contains(words), "no `{words}` in\n{text}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let rig = Rig::new("refuse");
    rig.run("fly", &LOCKSTEP).expect(0);
    rig.run("report", &["diff", "latest"]).expect(2).complains("<B>");
    rig.run("report", &["diff", "latest", "yesterday"]).expect(2).complains("no flight at yesterday");
    let empty = rig.out().join("empty");
    fs::create_dir(&empty).unwrap();
    rig.run("report", &["diff", "empty", "latest"]).expect(2).complains("holds no report");
    // As a flight leaves it whose recorder died.
    let mut report: Value = rig.report();
    report["distributions"] = Value::Array(vec![]);
    fs::write(empty.join("report.json"), report.to_string()).unwrap();
    rig.run("report", &["diff", "latest", "empty"]).expect(2).complains("no final report with distributions");
}
