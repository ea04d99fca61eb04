//! The summary that a flight ends with: at most 30 lines of at most 80 columns, the verdicts first.

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{Ended, Rig, not_tested, send, stop_for};
use render::flight::SECTION_NAMES;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::time::Duration;

const LOCKSTEP: &str = "--pace lockstep --duration 100ms";

/// Demands the form of what a flight ends with, and of what `ironbird report` says of it.
fn assert_brief(rig: &Rig, ended: Ended) -> Ended {
    let lines: Vec<&str> = ended.stdout.lines().collect();
    let (result, text) = lines.split_last().unwrap();
    assert!(result.starts_with("RESULT status="), "{ended}");
    let is_brief = |text: &[&str]| text.iter().all(|line| line.chars().count() <= 80);
    assert!(lines.len() <= 30 && is_brief(text), "{ended}");
    let count = |begin: &str| text.iter().filter(|it| it.starts_with(begin)).count();
    for head in ["Gates ", "Flown ", "Latencies [us] ", "More "] {
        assert_eq!(count(head), 1, "`{head}` in {ended}");
    }
    for head in ["Flight", "Timing", "Theorem"] {
        let key = head.to_lowercase();
        let verdict = ended.result()[&key].replace('-', " ").to_uppercase();
        assert_eq!(count(&format!("{head:<9} {verdict}: ")), 1, "{ended}");
        assert_eq!(count(&format!("{head} ")), 1, "{ended}");
    }
    assert_eq!(rig.ok("report").stdout, text.join("\n") + "\n");
    ended
}

#[test]
fn a_flight_in_lockstep_ends_with_what_matters() {
    let rig = Rig::new("lockstep");
    // Settings of the clock have no effect.
    let config = rig.settings("[rt]\nlead_us = 250\nmode = \"prefer\"\n");
    let line = format!("fly --pace lockstep --duration 500ms --rt off --config {config}");
    let ended = assert_brief(&rig, rig.ok(&line));
    let ended = ended.says("\nTiming    NOT MEASURED: in lockstep there are no deadlines\n");
    let page = rig
        .out()
        .join(&rig.run_directories()[0])
        .join("report.html");
    ended.says(&format!("\nPage      {}\n", page.display()));
    // Everything, and parts of it.
    let full = rig.ok("report --full").stdout;
    assert_eq!(full, rig.flown("report.txt"));
    let parts = SECTION_NAMES.map(|part| rig.ok(&format!("report --section {part}")).stdout);
    assert!(parts.iter().all(|part| !part.is_empty()), "{parts:?}");
    assert_eq!(parts.join("\n"), full);
    // There is no timer, and no tick of the mixer after the last one.
    assert!(!full.contains("Lead ") && !rig.flown("report.html").contains("Lead none"));
    rig.ok("replay")
        .says("inner loop fresh 501, ")
        .says("mixer      fresh 501, held 0, fallback 0, idle 0, ");
    rig.run("fly", rig.slowly(5, "50ms"));
    rig.ok("report --full")
        .says("Lead none: the plant's timer is set to the beginning of the tick");
}

#[test]
fn a_long_path_keeps_its_ends_and_the_result_has_it_whole() {
    let rig = Rig::new("long-path");
    let out = rig.file(&"of-a-rig-that-is-far-down-the-tree/".repeat(5));
    let ended = rig.ok(&format!("fly {LOCKSTEP} --out {out}"));
    let run = ended.result()["run"].clone();
    assert!(run.starts_with(&out), "{run}");
    let mut lines = ended.stdout.lines();
    let page = lines.find(|line| line.starts_with("Page ")).unwrap();
    assert_eq!(page.chars().count(), 80, "{page}");
    let shortened = page.strip_prefix("Page      ").unwrap();
    let (head, tail) = shortened.split_once("...").unwrap();
    assert!(run.starts_with(head), "{page}");
    assert!(format!("{run}/report.html").ends_with(tail), "{page}");
}

#[test]
fn what_there_is_no_room_for_is_left_to_the_full_report() {
    let rig = Rig::new("bad-day");
    rig.ok(&format!("fly {LOCKSTEP}"));
    let mut report = rig.report();
    let summary = |report: &Value| {
        let path = rig.out().join("latest/report.json");
        fs::write(path, report.to_string()).unwrap();
        rig.ok("report")
    };
    let gate =
        json!({"name": "a limit of some length", "limit": "<= 1", "value": "2", "held": false});
    report["verdict"]["gates"] = vec![gate; 12].into();
    let why = |i| format!("reason {i} {}", "of many ".repeat(40));
    let step = |i| json!({"step": "scheduler", "asked": 1, "granted": false, "refused": why(i)});
    report["roles"]["plant"]["realtime"] = (0..9).map(step).collect();
    let rest = "\n          ... the rest: ironbird report --full\nLatencies [us] ";
    let text = summary(&report).says(rest).says("\nPage      ").stdout;
    assert_eq!(text.lines().count(), 29, "{text}");
    assert!(
        text.lines().all(|line| line.chars().count() <= 80),
        "{text}"
    );
    // A sentence that is cut says so.
    report["verdict"]["gates"] = json!([]);
    let text = summary(&report).stdout;
    let cut: Vec<&str> = text.lines().filter(|line| line.ends_with(" ...")).collect();
    assert!(cut.len() == 1 && cut[0].starts_with("          "), "{text}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_on_the_clock_ends_with_six_latencies_and_its_outages() {
    let rig = Rig::new("outages");
    let config = rig.airborne("trajectory = \"hover\"\n");
    let flight = rig.take_off(format!("--rt off --duration 4s --config {config}"));
    rig.await_tick(0);
    for role in ["plant", "outer", "inner", "mixer"].repeat(3) {
        stop_for(flight.roles()[role], Duration::from_millis(20));
    }
    let mut ended = assert_brief(&rig, flight.end().expect(0))
        .says("\nTiming    ")
        .tells(" ticks without a fresh command on time (")
        .says("\nOutages   ")
        .tells("the longest: tick ");
    let series = "loop slack wake.plant hop.plant_outer hop.outer_inner hop.inner_mixer";
    for series in series.split(' ') {
        ended = ended.says(&format!("\n  {series} "));
    }
    rig.ok("report --section head")
        .says("\nreal time here: not ");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_lost_an_interrupted_and_an_aborted_flight_say_so_first() {
    let rig = Rig::new("lost");
    let fault = "--fault rotor_efficiency_1=0@100ms";
    let lost = rig.run("fly", format!("--pace lockstep --duration 5s {fault}"));
    let lost = assert_brief(&rig, lost.expect(3));
    let lost = lost.says("\n  FAIL flight envelope: left the envelope: ");
    assert!(
        lost.stdout
            .starts_with("Flight    LOST: left the envelope: ")
    );

    let flight = rig.take_off("--rt off --duration 600s");
    assert_brief(&rig, flight.interrupt().expect(130))
        .says("\nFlown     interrupted: trajectory lissajous");

    let flight = rig.start("fly", "--rt off --duration 600s");
    rig.await_tick(2500);
    send(flight.roles()["inner"], Signal::KILL);
    assert_brief(&rig, flight.end().expect(1))
        .says("\nFlown     the inner process died: ")
        .says("\nGates     ABORTED\n");
}

#[test]
#[ignore = "long: part of the gate"]
fn without_privilege_real_time_is_refused_where_it_is_required_and_else_the_summary_says_what_to_do()
 {
    let rig = Rig::new("student");
    let args = |mode| format!("--rt {mode} --config {} --duration 50ms", rig.slow(5));
    let Some(required) = fly_unprivileged(&rig, args("require")) else {
        return;
    };
    if required.code == Some(0) {
        return not_tested("this user is granted real time");
    }
    required
        .expect(4)
        .complains("real time was required and not granted to the")
        .complains("Scheduler (Operation not permitted (os error 1))")
        .complains("raise the rtprio limit")
        .complains("raise the memlock limit")
        .complains(
            "or fly with what is granted: --rt prefer; without root the same laws fly in lockstep",
        );
    rig.assert_nothing_left();
    let preferred = fly_unprivileged(&rig, args("prefer")).unwrap();
    let preferred = assert_brief(&rig, preferred.expect(0));
    assert_eq!(preferred.result()["rt"], "other", "{preferred}");
    // Once for all loops, with the remedies.
    preferred
        .says("\nRefused   ")
        .tells("scheduler to all loops: Operation not permitted")
        .tells("`ironbird doctor` lists remedies; those that need no root are --pace lockstep, flight.slowdown (slow motion)");
    rig.ok("report --section processes")
        .says("REFUSED (Operation not permitted (os error 1))");
    rig.assert_nothing_left();
}

#[test]
fn a_changed_schema_is_damage_and_not_another_version() {
    let rig = Rig::new("flipped-schema");
    rig.ok(&format!("fly {LOCKSTEP}"));
    let log = rig.out().join("latest/flight.mcap");
    let mut bytes = fs::read(&log).unwrap();
    // A name of a field in the schema of the topic `state`, before the first chunk.
    let name = b"deadline_miss_run";
    let mut windows = bytes.windows(name.len());
    let at = windows.position(|window| window == name).unwrap();
    bytes[at] ^= 1;
    fs::write(&log, bytes).unwrap();
    let refused = rig.run("replay", "").expect(1);
    let refused = refused.complains("flight.mcap is damaged or no flight log: ");
    assert!(!refused.stderr.contains("another version"), "{refused}");
}

#[test]
fn a_flight_is_judged_by_where_it_is_and_not_by_what_its_sensors_show() {
    let rig = Rig::new("judged");
    // Fixes that are off by metres. In 0.2 s, no airframe follows them far.
    let noisy = rig.settings(
        "[flight]\ntrajectory = \"hover\"\nduration_s = 0.2\nposition_error_max_m = 1.0\n\
         [plant]\nposition_noise_m = 8.0\n",
    );
    let simulated = rig.ok(&format!("simulate --config {noisy}"));
    let (_, rest) = simulated.stdout.split_once("largest ").unwrap();
    let error_m: f64 = rest.split(' ').next().unwrap().parse().unwrap();
    assert!(error_m < 1.0, "{simulated}");
    rig.ok(&format!("fly --pace lockstep --config {noisy}"));
    let outputs = &simulated.result()["outputs"];
    rig.ok("replay --verify")
        .says(&format!("identical; outputs {outputs}\n"));
    let flight = rig.final_report().flight;
    assert!(flight.position_error_max_m < 1.0 && flight.lowest_z_m > -1.0);
    // states.csv has the readings of the sensors.
    let states = rig.flown("states.csv");
    let mut lines = states.lines().map(|line| line.split(','));
    let column = lines.next().unwrap().position(|name| name.starts_with('z'));
    let mut z_m = lines.map(|mut row| row.nth(column.unwrap()).unwrap().parse::<f64>());
    assert!(
        z_m.any(|z_m| z_m.is_ok_and(|z_m| z_m.abs() > 2.0)),
        "{states}"
    );
}
