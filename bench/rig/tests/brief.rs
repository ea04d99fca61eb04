//! What a flight ends with, however it ended: at most 30 lines of at most 80 columns, and what matters first.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;
use std::thread::sleep;
use std::time::Duration;

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{Ended, Rig, send, stop_for};
use rustix::process::Signal;

/// Demands the form of what a flight ends with, and of what `ironbird report` says of it.
fn assert_brief(rig: &Rig, ended: Ended) -> Ended {
    let lines: Vec<&str> = ended.stdout.lines().collect();
    assert!(lines.len() <= 30, "{} lines: {ended}", lines.len());
    let (result, text) = lines.split_last().unwrap();
    assert!(result.starts_with("RESULT status="), "{ended}");
    for line in text {
        assert!(line.chars().count() <= 80, "{} columns: {line}\nof {ended}", line.chars().count());
    }
    for (what, least) in
        [("Flight", 1), ("Timing", 1), ("Theorem", 1), ("Gates", 1), ("Flown", 1), ("Latencies [us]", 1), ("More", 1)]
    {
        let times = text.iter().filter(|line| line.starts_with(&format!("{what} "))).count();
        assert_eq!(times, least, "`{what}` in {ended}");
    }
    for (word, key) in [("Flight", "flight"), ("Timing", "timing"), ("Theorem", "theorem")] {
        let told = ended.result()[key].replace('-', " ").to_uppercase();
        assert!(text.iter().any(|line| line.starts_with(&format!("{word:<9} {told}: "))), "{word} {told}: {ended}");
    }
    let report = rig.run("report", &[]).expect(0);
    assert_eq!(report.stdout, text.join("\n") + "\n", "`ironbird report` says the same");
    ended
}

#[test]
fn a_flight_in_lockstep_ends_with_what_matters() {
    let rig = Rig::new("lockstep");
    let ended = assert_brief(&rig, rig.run("fly", &["--pace", "lockstep", "--duration", "500ms"]).expect(0));
    let ended = ended.says("\nTiming    NOT MEASURED: in lockstep there are no deadlines\n");
    let [name] = <[String; 1]>::try_from(rig.run_directories()).unwrap();
    let page = rig.out().join(&name).join("report.html");
    ended.says(&format!("\nPage      {}\n", page.display()));
    // Everything, and parts of it.
    let full = rig.run("report", &["--full"]).expect(0);
    assert_eq!(full.stdout, fs::read_to_string(rig.out().join("latest/report.txt")).unwrap());
    let mut parts = String::new();
    for part in report::text::SECTION_NAMES {
        let said = rig.run("report", &["--section", part]).expect(0).stdout;
        assert!(!said.is_empty(), "{part}");
        parts += &(if parts.is_empty() { said } else { format!("\n{said}") });
    }
    assert_eq!(parts, full.stdout);
}

#[test]
fn a_long_path_keeps_its_ends_and_the_result_has_it_whole() {
    let rig = Rig::new("long-path");
    let out = rig.out().join("of-a-rig-that-is-far-down-the-tree/".repeat(5));
    let out = out.to_str().unwrap();
    let ended = rig.run("fly", &["--pace", "lockstep", "--duration", "100ms", "--out", out]).expect(0);
    let run = ended.result()["run"].clone();
    assert!(run.starts_with(out), "{run}");
    let page = ended.stdout.lines().find(|line| line.starts_with("Page ")).unwrap();
    assert_eq!(page.chars().count(), 80, "{page}");
    let (head, tail) = page.strip_prefix("Page      ").unwrap().split_once("...").unwrap();
    assert!(run.starts_with(head) && format!("{run}/report.html").ends_with(tail), "{page}");
}

#[test]
fn what_there_is_no_room_for_is_left_to_the_full_report() {
    let rig = Rig::new("bad-day");
    rig.run("fly", &["--pace", "lockstep", "--duration", "100ms"]).expect(0);
    let path = rig.out().join("latest/report.json");
    let mut report = rig.report();
    let broken = serde_json::json!({"name": "a limit of some length", "limit": "<= 1", "value": "2", "held": false});
    report["verdict"]["gates"] = vec![broken; 12].into();
    let refused = |why: String| serde_json::json!({"step": "scheduler", "asked": 1, "granted": false, "refused": why});
    report["roles"]["plant"]["realtime"] =
        (0..9).map(|i| refused(format!("reason {i} {}", "of many ".repeat(40)))).collect();
    fs::write(&path, report.to_string()).unwrap();
    let said = rig
        .run("report", &[])
        .expect(0)
        .says("\n          ... the rest: ironbird report --full\nLatencies [us] ")
        .stdout;
    assert_eq!(said.lines().count(), 29, "{said}");
    assert!(said.lines().all(|line| line.chars().count() <= 80) && said.contains("\nPage      "), "{said}");
    // A sentence that is cut says so.
    report["verdict"]["gates"] = serde_json::json!([]);
    fs::write(&path, report.to_string()).unwrap();
    let said = rig.run("report", &[]).expect(0).stdout;
    let cut: Vec<&str> = said.lines().filter(|line| line.ends_with(" ...")).collect();
    assert!(cut.len() == 1 && cut[0].starts_with("          "), "{said}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_on_the_clock_ends_with_six_latencies_and_its_outages() {
    let rig = Rig::new("outages");
    let flight = rig.take_off(&["--rt", "off", "--duration", "6s"]);
    let roles = flight.roles();
    for round in 0..20 {
        for role in ["plant", "outer", "inner", "mixer"] {
            stop_for(roles[role], Duration::from_millis(5 + round));
            sleep(Duration::from_millis(20));
        }
    }
    let ended = assert_brief(&rig, flight.end().expect(0));
    let ended =
        ended.says("\nTiming    ").tells(" deadlines missed (").says("\nOutages   ").tells("the longest: tick ");
    for series in ["loop", "slack", "wake.plant", "hop.plant_outer", "hop.outer_inner", "hop.inner_mixer"] {
        assert!(ended.stdout.contains(&format!("\n  {series} ")), "{series}: {ended}");
    }
    // The clock of this flight was the machine's, whatever that is worth.
    let head = rig.run("report", &["--section", "head"]).expect(0);
    head.says("\nreal time here: not ");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_lost_an_interrupted_and_a_dead_flight_say_so_first() {
    let rig = Rig::new("lost");
    let fault = ["--fault", "rotor_efficiency_1=0@100ms"];
    let lost = rig.run("fly", &[&["--pace", "lockstep", "--duration", "5s"], &fault[..]].concat());
    let lost = assert_brief(&rig, lost.expect(3)).says("\n  FAIL flight envelope: left the envelope: ");
    assert!(lost.stdout.starts_with("Flight    LOST: left the envelope: "), "{lost}");

    let flight = rig.take_off(&["--rt", "off", "--duration", "600s"]);
    flight.signal(Signal::INT);
    assert_brief(&rig, flight.end().expect(130)).says("\nFlown     interrupted: trajectory lissajous");

    let flight = rig.take_off(&["--rt", "off", "--duration", "600s"]);
    rig::wait_until("a report", || rig.out().join("latest/report.json").exists().then_some(()));
    sleep(Duration::from_millis(1500));
    send(flight.roles()["inner"], Signal::KILL);
    let ended = assert_brief(&rig, flight.end().expect(1));
    ended.says("\nFlown     the inner process died: ").says("\nGates     ABORTED\n");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_student_without_root_reads_what_was_refused_and_what_he_can_do() {
    let rig = Rig::new("student");
    let Some(ended) = fly_unprivileged(&rig, &["--duration", "1s"]) else { return };
    if ended.result()["rt"] != "other" {
        rig::not_tested("this user is granted real time");
        return;
    }
    let ended = assert_brief(&rig, ended.expect(0));
    ended
        .says("\nRefused   ")
        .tells("scheduler to all loops: Operation not permitted")
        .tells("`ironbird doctor` lists remedies; those that need no root are");
}
