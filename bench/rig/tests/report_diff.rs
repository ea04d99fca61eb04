//! `ironbird report diff` on real flights.

use std::fs;

use crate::rig::Rig;
use serde_json::Value;

const LOCKSTEP: [&str; 4] = ["--pace", "lockstep", "--duration", "1500ms"];

/// Flights with these further flags, one after the other: their names.
fn fly(rig: &Rig, flags: &[&[&str]]) -> Vec<String> {
    for further in flags {
        rig.run("fly", [&LOCKSTEP[..], further].concat()).expect(0);
    }
    rig.run_directories()
}

fn figure<'a>(diff: &'a Value, name: &str) -> &'a Value {
    let figures = diff["figures"].as_array().unwrap();
    figures
        .iter()
        .find(|figure| figure["name"] == name)
        .unwrap_or_else(|| panic!("no {name} in {diff}"))
}

#[test]
fn two_flights_show_numbers_without_a_verdict() {
    let rig = Rig::new("two");
    let flights = fly(&rig, &[&[], &["--trajectory", "hover"]]);
    let facts = rig.out().join(&flights[1]).join("run.json");
    let text = fs::read_to_string(&facts).unwrap();
    let clock = text
        .lines()
        .find(|line| line.contains("\"clock_source\""))
        .unwrap();
    fs::write(
        &facts,
        text.replace(clock, "\"clock_source\": \"sundial\","),
    )
    .unwrap();
    let text = rig
        .ok(&format!("report diff {} {}", flights[0], flights[1]))
        .stdout;
    for words in [
        "Timing    not judged: one flight a side shows numbers alone",
        "Tracking  not judged: one flight a side shows numbers alone",
        "flight.trajectory: lissajous | hover",
        "| sundial",
        "loop p50 [us]",
        "figures have too few values",
    ] {
        assert!(text.contains(words), "no `{words}` in\n{text}");
    }
    let verdicts = ["MORE", "LESS", "DIFFER"];
    assert!(!verdicts.iter().any(|word| text.contains(word)), "{text}");
    let diff = rig
        .ok(&format!(
            "report diff {} {} --format json",
            flights[0], flights[1]
        ))
        .json();
    let p50 = figure(&diff, "loop p50 [us]");
    let of = |side: &str| p50[side][0].as_f64().unwrap();
    assert_eq!(p50["ratio"].as_f64().unwrap(), of("b") / of("a"));
    assert_eq!(
        (&p50["says"], &p50["probability"]),
        (&"not_judged".into(), &Value::Null)
    );
    // 1501 ticks say nothing about one in a thousand.
    assert_eq!(figure(&diff, "loop p99.9 [us]")["says"], "too_few_values");
}

#[test]
fn groups_differ_in_what_was_changed_and_in_nothing_else() {
    let rig = Rig::new("groups");
    let other: &[&str] = &["--fault", "mass_kg=0.55@100ms"];
    let flights = fly(&rig, &[&[], other, &[], other, &[], other, &[]]);
    let [a1, b1, a2, b2, a3, b3, a4] = &flights[..] else {
        panic!("{flights:?}")
    };
    let compare = |args: &[&str]| {
        let args = [&["diff", "--format", "json"], args].concat();
        rig.run("report", &args).expect(0).json()
    };
    let diff = compare(&[a1, a2, a3, "--", b1, b2, b3]);
    assert_eq!(diff["tracking"]["says"], "judged", "{diff}");
    // A heavier airframe sinks, in every one of three flights: 2 of the 20 ways to deal them out.
    let rms = figure(&diff, "position error, rms [m]");
    assert_eq!(
        (&rms["says"], &rms["probability"]),
        (&"more".into(), &0.1.into()),
        "{rms}"
    );
    // In lockstep, latencies are those of no loop on a clock.
    let reason = diff["timing"]["reason"].as_str().unwrap();
    assert!(
        reason.contains(": in lockstep there are no deadlines"),
        "{reason}"
    );
    assert_eq!(figure(&diff, "loop p50 [us]")["probability"], Value::Null);
    // Flights in lockstep are the same bit for bit, so that nothing differs.
    let alike = compare(&[a1, a2, "--", a3, a4]);
    assert!(
        alike["tracking"]["reason"]
            .as_str()
            .unwrap()
            .starts_with("2 and 2 flights"),
        "{alike}"
    );
    let rms = figure(&alike, "position error, rms [m]");
    assert_eq!((&rms["a"], &rms["says"]), (&rms["b"], &"not_judged".into()));
    let text = rig
        .ok(&format!("report diff {a1} {a2} {a3} -- {b1} {b2} {b3}"))
        .stdout;
    assert!(
        text.lines().nth(2).unwrap().starts_with("Tracking  "),
        "{text}"
    );
    assert!(
        text.contains("figures DIFFER (probability of even one false difference: 10 %)"),
        "{text}"
    );
    assert!(text.contains(" MORE\n"), "{text}");
    // Paths and values of settings are as long as they are.
    let is_as_long =
        |line: &str| line.contains(a1.as_str()) || line.starts_with("  ") && line.contains(" | ");
    assert!(
        text.lines()
            .all(|line| line.chars().count() <= 80 || is_as_long(line)),
        "{text}"
    );
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let rig = Rig::new("refuse");
    rig.run("fly", LOCKSTEP).expect(0);
    rig.refused("report diff latest")
        .complains("only one flight given");
    let three = rig.refused("report diff latest latest latest");
    three
        .complains("3 flights without `--`: it is not clear which belong to A")
        .complains("A1 A2 A3 -- B1 B2 B3");
    rig.refused("report diff").complains("<A>");
    rig.refused("report diff latest latest")
        .complains("is named twice");
    let behind = rig.refused("report diff latest -- latest --format json");
    behind
        .complains("--format: only flights may follow `--`, no flags")
        .complains("--format json A1");
    rig.refused("report diff latest yesterday")
        .complains("no flight at yesterday");
    let empty = rig.out().join("empty");
    fs::create_dir(&empty).unwrap();
    rig.refused("report diff empty latest")
        .complains("holds no report");
    // As a flight leaves it whose recorder died.
    let mut report: Value = rig.report();
    report["distributions"] = Value::Array(vec![]);
    fs::write(empty.join("report.json"), report.to_string()).unwrap();
    rig.refused("report diff latest empty")
        .complains("no final report with distributions");
}
