//! `ironbird report diff` on real flights.

use crate::rig::Rig;
use serde_json::Value;
use std::fs;

/// Flights with these further flags, one after the other: their names.
fn fly(rig: &Rig, flags: &[&str]) -> Vec<String> {
    for further in flags {
        rig.ok(&format!("fly --pace lockstep --duration 1500ms {further}"));
    }
    rig.run_directories()
}

fn figure<'a>(diff: &'a Value, name: &str) -> &'a Value {
    let mut figures = diff["figures"].as_array().unwrap().iter();
    let figure = figures.find(|figure| figure["name"] == name);
    figure.unwrap_or_else(|| panic!("no {name} in {diff}"))
}

#[test]
fn two_flights_show_numbers_without_a_verdict() {
    let rig = Rig::new("two");
    let flights = fly(&rig, &["", "--trajectory hover"]);
    let facts = rig.out().join(&flights[1]).join("run.json");
    let mut run: Value = serde_json::from_str(&fs::read_to_string(&facts).unwrap()).unwrap();
    let clock = run.pointer_mut("/host/clock_source").unwrap();
    *clock = "sundial".into();
    fs::write(&facts, run.to_string()).unwrap();
    let diff = format!("report diff {} {}", flights[0], flights[1]);
    let text = rig.ok(&diff).stdout;
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
    let diff = rig.ok(&format!("{diff} --format json")).json();
    let p50 = figure(&diff, "loop p50 [us]");
    let [a, b] = ["a", "b"].map(|side| p50[side][0].as_f64().unwrap());
    assert_eq!(p50["ratio"], b / a);
    assert_eq!(p50["says"], "not_judged");
    assert!(p50["probability"].is_null());
    // 1501 ticks say nothing about one in a thousand.
    assert_eq!(figure(&diff, "loop p99.9 [us]")["says"], "too_few_values");
}

#[test]
fn groups_differ_in_what_was_changed_and_in_nothing_else() {
    let rig = Rig::new("groups");
    let other = "--fault mass_kg=0.55@100ms";
    let flights = fly(&rig, &["", other, "", other, "", other, ""]);
    let [a1, b1, a2, b2, a3, b3, a4] = &flights[..] else {
        panic!("{flights:?}")
    };
    let compare = |sides: &str| {
        let line = format!("report diff --format json {sides}");
        rig.ok(&line).json()
    };
    let sides = format!("{a1} {a2} {a3} -- {b1} {b2} {b3}");
    let diff = compare(&sides);
    assert_eq!(diff["tracking"]["says"], "judged", "{diff}");
    // A heavier airframe sinks, in every one of three flights: 2 of the 20 ways to deal them out.
    let rms = figure(&diff, "position error, rms [m]");
    assert_eq!(
        (&rms["says"], &rms["probability"]),
        (&"more".into(), &0.1.into())
    );
    // In lockstep, latencies are those of no loop on a clock.
    let reason = diff["timing"]["reason"].as_str().unwrap();
    assert!(
        reason.contains(": in lockstep there are no deadlines"),
        "{reason}"
    );
    assert!(figure(&diff, "loop p50 [us]")["probability"].is_null());
    // Flights in lockstep are the same bit for bit, so that nothing differs.
    let alike = compare(&format!("{a1} {a2} -- {a3} {a4}"));
    let reason = alike["tracking"]["reason"].as_str().unwrap();
    assert!(reason.starts_with("2 and 2 flights"), "{alike}");
    let rms = figure(&alike, "position error, rms [m]");
    assert_eq!((&rms["a"], &rms["says"]), (&rms["b"], &"not_judged".into()));
    let text = rig.ok(&format!("report diff {sides}"));
    let text = text
        .says("figures DIFFER (probability of even one false difference: 10 %)")
        .says(" MORE\n")
        .stdout;
    assert!(
        text.lines().nth(2).unwrap().starts_with("Tracking  "),
        "{text}"
    );
    // Paths and values of settings are as long as they are.
    let may_be_long =
        |line: &str| line.contains(a1.as_str()) || line.starts_with("  ") && line.contains(" | ");
    let is_short = |line: &str| line.chars().count() <= 80 || may_be_long(line);
    assert!(text.lines().all(is_short), "{text}");
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let rig = Rig::new("refuse");
    fly(&rig, &[""]);
    let empty = rig.out().join("empty");
    fs::create_dir(&empty).unwrap();
    // As a flight leaves it whose recorder died.
    fs::create_dir(rig.out().join("partial")).unwrap();
    let mut report = rig.report();
    report["distributions"] = Value::Array(vec![]);
    fs::write(rig.out().join("partial/report.json"), report.to_string()).unwrap();
    for (sides, words) in [
        ("latest", "only one flight given"),
        (
            "latest latest latest",
            "3 flights without `--`: it is not clear which belong to A",
        ),
        ("latest latest latest", "A1 A2 A3 -- B1 B2 B3"),
        ("", "<A>"),
        ("latest latest", "is named twice"),
        (
            "latest -- latest --format json",
            "--format: only flights may follow `--`, no flags",
        ),
        ("latest -- latest --format json", "--format json A1"),
        ("latest yesterday", "no flight at yesterday"),
        ("empty latest", "holds no report"),
        ("latest partial", "no final report with distributions"),
    ] {
        rig.refused(&format!("report diff {sides}"))
            .complains(words);
    }
}
