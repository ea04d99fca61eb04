//! Margins of a short flight are as in `snapshots/`: `INSTA_UPDATE=always cargo test -p experiments` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use analysis::margin::Bounds;
use config::Settings;
use experiments::margin::limits::{BOUNDS, Phases, bounds};
use experiments::margin::target::Target;
use experiments::margin::{Task, measure_all};
use faults::Port;
use hashed::{figures, hashed};
use messages::role::Role;

/// The figures that a person checks.
const SHOWN: [(&str, &str); 6] = [
    ("", "trajectory airframe phases_s longest_ticks"),
    ("/bounds", "recovered_below_m recovery_max_s survival_max_s"),
    ("/laws", "laws/inner qualified flights"),
    ("/laws/0/unfaulted", "peak_m recovery_s cause"),
    ("/laws/0/searches", "kind of most limits"),
    ("/laws/0/searches/0/points", "at peak_m recovery_s cause"),
];

#[test]
fn the_margins_of_a_short_flight_are_their_snapshot() {
    let settings = Settings::resolve(None, &Vec::new()).unwrap();
    let phases = Phases {
        ticks: vec![2000, 2100],
        span_s: 0.2,
        cycle_s: None,
    };
    let task = Task {
        targets: vec![
            Target::Stage(Role::Inner),
            Target::Input(Port::PlantRotorSpeeds),
        ],
        bounds: Bounds {
            recovery_max_s: 1.0,
            survival_max_s: 2.0,
            ..bounds(&[], &settings).unwrap()
        },
        longest: 60,
        jobs: 2,
    };
    let mut margins = measure_all(&[settings], &phases, &task, &AtomicBool::new(false)).unwrap();
    // Of functions whose last digit depends on the C library.
    let predicted = std::mem::take(&mut margins.laws[0].predicted);
    insta::assert_snapshot!("predicted", format!("{predicted:#.6?}"));
    // A hash of every setting that there is, and this version.
    margins.laws[0].fingerprint.clear();
    margins.build = Default::default();
    let text = analysis::json::to_string(&margins).unwrap();
    let shown = figures(&serde_json::from_str(&text).unwrap(), &SHOWN);
    insta::assert_snapshot!("margins", hashed("margins", &text, &shown));
}

#[test]
fn phases_and_bounds_follow_the_flight() {
    let step = vec![("flight.trajectory", toml::Value::from("step"))];
    let settings = Settings::resolve(None, &step).unwrap();
    let ticks = |duration_s: Option<f64>| {
        let duration = duration_s.map(Duration::from_secs_f64);
        Phases::new(2, duration, &settings).map(|it| it.ticks).ok()
    };
    assert_eq!(ticks(None), Some(vec![5000, 10_000]));
    assert_eq!(ticks(Some(8.0)), Some(vec![5000, 6500]));
    assert_eq!(ticks(Some(5.001)), None);
    let is_taken = |bound: &[_]| bounds(bound, &settings).is_ok();
    assert!(is_taken(&[(BOUNDS[2], 20.0)]) && !is_taken(&[(BOUNDS[2], 20.5)]));
    assert!(!is_taken(&[(BOUNDS[0], 0.1), (BOUNDS[0], 0.1)]));
}
