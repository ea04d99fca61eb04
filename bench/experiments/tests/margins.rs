//! Margins of a short flight are as in `snapshots/`: `INSTA_UPDATE=always cargo test -p experiments` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use analysis::margin::{Bounds, CALM, Cause, Kind, SURVIVES, UNNOTICED};
use config::Settings;
use experiments::margin::flights::Flights;
use experiments::margin::limits::{BOUNDS, Phases, bounds};
use experiments::margin::prediction::predicted;
use experiments::margin::search::questions;
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
    ("/laws/0/unfaulted", "peak_m peak_yaw_rad recovery_s cause"),
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

fn hover(airframe: &str, inner: &'static str) -> Settings {
    let set = vec![
        ("flight.trajectory", toml::Value::from("hover")),
        ("flight.airframe", toml::Value::from(airframe)),
        ("inner.law", toml::Value::from(inner)),
    ];
    Settings::resolve(None, &set).unwrap()
}

#[test]
fn the_predicted_gain_is_that_at_which_flights_of_any_airframe_begin_to_oscillate() {
    const FROM: u64 = 10_000;
    let stop = AtomicBool::new(false);
    for (airframe, inner) in [("crazyflie", "adaptive"), ("x500", "l1"), ("x500", "pid")] {
        let settings = hover(airframe, inner);
        let predicted = predicted(&settings, &stop).unwrap();
        let (gain, _) = predicted.least(|axis| axis.gain).unwrap();
        let bounds = bounds(&[], &settings).unwrap();
        let flights = Flights::new(&settings, bounds, FROM, &stop).unwrap();
        let airframe_flown = settings.airframe().unwrap();
        let targets = [Target::Input(Port::PlantRotorSpeeds)];
        let mut questions = questions(&targets, 1, &airframe_flown).into_iter();
        let (question, _) = questions.find(|(it, _)| it.kind == Kind::Gain).unwrap();
        // In tenths above 1.
        let is_calm = |gain: f64| {
            let tenths = (10.0 * (gain - 1.0)).round() as u64;
            let fault = question.fault(tenths, FROM, 1_000_000, &airframe_flown);
            bounds.hold(CALM, &flights.fly(tenths, fault, None).unwrap())
        };
        let calm = [0.9, 1.1].map(|share| is_calm(share * gain));
        assert_eq!(calm, [true, false], "{airframe} {inner}: {gain}");
    }
}

#[test]
fn a_loop_with_an_axis_that_does_not_settle_has_no_predicted_margin() {
    let stop = AtomicBool::new(false);
    let predicted = predicted(&hover("crazyflie", "sliding"), &stop).unwrap();
    assert_eq!(predicted.unsettled, ["yaw"]);
    assert!(predicted.least(|axis| axis.gain).is_none() && !predicted.axes.is_empty());
}

#[test]
fn a_flight_that_keeps_its_position_and_loses_its_heading_does_not_recover() {
    let stop = AtomicBool::new(false);
    let settings = hover("crazyflie", "indi");
    let bounds = bounds(&[], &settings).unwrap();
    let flights = Flights::new(&settings, bounds, 10_000, &stop).unwrap();
    let fault = "setpoint.attitude_rad.yaw.bias=0.3@tick10000".to_owned();
    let turned = flights.fly(1, fault, None).unwrap();
    assert_eq!(turned.cause, Some(Cause::Yaw), "{turned:?}");
    assert!(turned.peak_m.unwrap() < 0.1 && turned.peak_yaw_rad.unwrap() > 0.1);
    assert!(!bounds.hold(SURVIVES, &turned) && !bounds.hold(UNNOTICED, &turned));
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
    assert!(is_taken(&[(BOUNDS[4], 20.0)]) && !is_taken(&[(BOUNDS[4], 20.5)]));
    assert!(!is_taken(&[(BOUNDS[0], 0.1), (BOUNDS[0], 0.1)]));
}
