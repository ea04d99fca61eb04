//! Stages that stop in flight: the report of a flight that nobody controls, and of one that ends in an outage.

use crate::rig::{Rig, Running, read_log, send, wait_until};
use controller::Trajectory;
use flight_log::entry::LogEntry;
use report::schema::Report;
use report::traces;
use rustix::process::Signal;
use std::fs;
use std::path::Path;

/// Distances of all states in a log from the reference of their tick [m].
fn errors_m(log: &Path, trajectory: Trajectory, period_s: f64) -> Vec<f64> {
    let mut errors = Vec::new();
    for entry in read_log(log).0 {
        let LogEntry::State(message) = entry else {
            continue;
        };
        let reference: [f64; 3] = trajectory
            .reference(message.envelope.tick as f64 * period_s)
            .position_w_m;
        let squares = reference
            .iter()
            .zip(message.content.measured.position_w_m)
            .map(|(r, p)| (r - p) * (r - p));
        errors.push(squares.sum::<f64>().sqrt());
    }
    errors
}

/// The final report, when it is there.
fn final_report(rig: &Rig) -> Report {
    let path = rig.out().join("latest/report.json");
    wait_until("the final report", || {
        Report::read(&path)
            .ok()
            .filter(|report| !report.run.in_flight)
    })
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_nobody_controls_is_reported_as_far_from_its_reference_as_it_was() {
    for role in ["inner", "mixer"] {
        let rig = Rig::new("uncontrolled");
        let flight = rig.take_off("--rt off --duration 3s --trajectory hover");
        rig.await_tick(500);
        let stopped = flight.roles()[role];
        send(stopped, Signal::STOP);
        let report = final_report(&rig);
        // It can only end when it goes on.
        send(stopped, Signal::CONT);
        let ended = flight.end();
        let directory = rig.out().join("latest");
        let errors = errors_m(&directory.join("flight.mcap"), Trajectory::Hover, 1e-3);
        let (last, max) = (
            *errors.last().unwrap(),
            errors.iter().copied().fold(0.0, f64::max),
        );
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!(max > 1.0, "{role}: without it the airframe falls, {max} m");
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b;
        let told = &report.flight;
        assert!(
            close(told.position_error_max_m, max),
            "{role}: {} m is not {max} m",
            told.position_error_max_m
        );
        assert!(
            close(told.position_error_final_m, last) && close(told.position_error_rms_m, rms),
            "{told:?}"
        );
        assert_eq!(told.states, errors.len() as u64, "{role}");
        let without = report.ticks.run + report.ticks.skipped - told.states;
        assert_eq!(told.ticks_without_state, without, "{role}");
        let words = format!(
            "position error rms {rms:.4} m, largest {max:.4} m, at the end {last:.4} m, over"
        );
        let tracking = rig.ok("report --section tracking");
        tracking
            .says(&words)
            .says(&format!("over {} states", told.states));
        assert!(!ended.stdout.contains("IN FLIGHT"), "{ended}");
        rig.ok("replay").says(&words);
        // A row every 50 ticks, up to the end; what the stopped stage did not say is empty.
        let states = fs::read_to_string(directory.join("states.csv")).unwrap();
        let rows: Vec<Vec<&str>> = states
            .lines()
            .rev()
            .take(5)
            .map(|row| row.split(',').collect())
            .collect();
        let t_s: f64 = rows[0][0].parse().unwrap();
        let flown_s = report.ticks.run as f64 * 1e-3;
        assert!(
            flown_s - t_s < 0.2,
            "{role}: the last row is of {t_s} s, the flight took {flown_s} s"
        );
        // The other one may have skipped a tick, but not all of them.
        let silent = |column: usize| rows.iter().all(|row| row[column].is_empty());
        assert_eq!(
            (silent(13), silent(16)),
            (role == "inner", role == "mixer"),
            "{rows:?}"
        );
        let spans: Vec<_> = report
            .traces
            .as_ref()
            .unwrap()
            .flight
            .spans(traces::DISTANCE)
            .collect();
        assert!(
            spans.iter().any(|span| span.max > 0.99 * max),
            "{role}: the picture shows it"
        );
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn an_outage_that_ends_a_flight_is_late_until_its_end() {
    let rig = Rig::new("tail");
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 400ms",
        rig.slow(10)
    ));
    let mixer = flight.roles()["mixer"];
    rig.await_tick(330);
    send(mixer, Signal::STOP);
    let report = final_report(&rig);
    send(mixer, Signal::CONT);
    flight.end().expect(0);
    let (ticks, deadlines) = (report.ticks.run + report.ticks.skipped, &report.deadlines);
    let count = |name: &str| report.series(name).map_or(0, |series| series.count);
    assert_eq!(ticks, 401);
    let lengths = deadlines.runs.iter().map(|run| run.length_ticks);
    let outage = lengths.max().unwrap_or(0);
    assert!(outage >= 30, "{deadlines:?}");
    let late: u64 = deadlines.late.iter().map(|bucket| bucket.count).sum();
    assert_eq!(
        (deadlines.missed_by_stamps, late),
        (deadlines.missed, deadlines.missed)
    );
    assert_eq!(
        (count("slack") + count("late"), count("wake.mixer")),
        (ticks, ticks)
    );
    // Ten milliseconds a tick: the first of them is late until the end.
    let least_us = (outage - 1) as f64 * 10e3;
    let latest_us = report.series("late").unwrap().max_us;
    assert!(
        latest_us >= least_us && report.series("wake.mixer").unwrap().max_us >= least_us,
        "{latest_us} us"
    );
    rig.assert_nothing_left();
}

/// The four loops, each started by hand.
fn loops(rig: &Rig, options: &[&str]) -> [Running; 4] {
    ["plant", "outer", "inner", "mixer"].map(|role| rig.start(role, options))
}

#[test]
#[ignore = "long: part of the gate"]
fn what_stages_do_after_the_plants_death_is_no_part_of_the_flight() {
    let rig = Rig::new("orphaned");
    let config = rig.slow(2);
    let options = ["--rt", "off", "--config", &config, "--duration", "60s"];
    let stages = loops(&rig, &options);
    let recorder = rig.start("record", options);
    rig.await_flight();
    rig.await_tick(300);
    stages[0].signal(Signal::KILL);
    let ended = recorder.end();
    stages.into_iter().for_each(|stage| drop(stage.end()));
    assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
    let report = final_report(&rig);
    for name in ["loop", "wake.inner", "wake.mixer", "compute.mixer"] {
        let count = report.series(name).unwrap().count;
        assert!(
            count <= report.ticks.run + report.ticks.skipped,
            "{name}: {count} values, ticks {:?}",
            report.ticks
        );
    }
}

#[test]
fn a_flight_whose_plant_fell_silent_was_not_in_time() {
    let rig = Rig::new("silent");
    let flight = rig.take_off("--duration 60s");
    rig.await_tick(300);
    send(flight.roles()["plant"], Signal::KILL);
    let ended = flight.end().expect(1);
    let result = ended.result();
    assert_eq!(result["status"], "ABORTED", "{ended}");
    assert!(
        ["late", "not-measured", "cut-short"].contains(&result["timing"].as_str()),
        "{ended}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_recorder_that_saw_half_a_flight_says_so_and_so_does_the_one_that_died() {
    let rig = Rig::new("half");
    let config = rig.slow(2);
    let options = ["--rt", "off", "--config", &config, "--duration", "3s"];
    let stages = loops(&rig, &options);
    let first = rig.start("record", options);
    rig.await_flight();
    rig.await_report();
    let in_flight = rig.ok("report");
    assert!(
        in_flight.stdout.contains("IN FLIGHT"),
        "its recorder lives: {in_flight}"
    );
    first.signal(Signal::KILL);
    assert_eq!(first.end().code, None);
    let second = rig.start("record", options).end().expect(0);
    stages
        .into_iter()
        .for_each(|stage| drop(stage.end().expect(0)));
    let [dead, _] = <[String; 2]>::try_from(rig.run_directories()).unwrap();
    rig.run("report", &dead)
        .expect(0)
        .says("\nFlown     the recorder of this flight died at 2")
        .says("\nGates     ABORTED");
    let report = final_report(&rig);
    let lost: u64 = report.recorder.lost.values().sum();
    let result = second.result();
    assert!(lost > 100, "{lost}");
    // Nor does it judge the estimates, of which it knows no beginning.
    assert!(
        report.theorem.ticks_checked == 0 && report.theorem.ticks_unwatched > 100,
        "{:?}",
        report.theorem
    );
    assert_eq!(
        (result["status"].as_str(), &result["lost"]),
        ("INCOMPLETE", &lost.to_string())
    );
    let second = second.says(&format!("INCOMPLETE RECORD: {lost} of "));
    assert!(
        second
            .stdout
            .lines()
            .take(9)
            .any(|line| line.starts_with("INCOMPLETE RECORD")),
        "at the top: {second}"
    );
    // What it has not seen, it does not call late.
    assert!(
        report.deadlines.missed_by_stamps <= report.deadlines.missed,
        "{:?}",
        report.deadlines
    );
    assert_eq!(report.ticks.run + report.ticks.skipped, 3001);
    assert!(report.series("loop").unwrap().count < report.ticks.run);
}
