//! The summary that a flight ends with: at most 30 lines of at most 80 columns, the verdicts first.

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{self, Ended, Rig, send, stop_for};
use rustix::process::Signal;
use std::fs;
use std::thread::sleep;
use std::time::Duration;

/// Demands the form of what a flight ends with, and of what `ironbird report` says of it.
fn assert_brief(rig: &Rig, ended: Ended) -> Ended {
    let lines: Vec<&str> = ended.stdout.lines().collect();
    assert!(lines.len() <= 30, "{} lines: {ended}", lines.len());
    let (result, text) = lines.split_last().unwrap();
    assert!(result.starts_with("RESULT status="), "{ended}");
    for line in text {
        assert!(
            line.chars().count() <= 80,
            "{} columns: {line}\nof {ended}",
            line.chars().count()
        );
    }
    for (what, least) in [
        ("Flight", 1),
        ("Timing", 1),
        ("Theorem", 1),
        ("Gates", 1),
        ("Flown", 1),
        ("Latencies [us]", 1),
        ("More", 1),
    ] {
        let times = text
            .iter()
            .filter(|line| line.starts_with(&format!("{what} ")))
            .count();
        assert_eq!(times, least, "`{what}` in {ended}");
    }
    for (word, key) in [
        ("Flight", "flight"),
        ("Timing", "timing"),
        ("Theorem", "theorem"),
    ] {
        let told = ended.result()[key].replace('-', " ").to_uppercase();
        assert!(
            text.iter()
                .any(|line| line.starts_with(&format!("{word:<9} {told}: "))),
            "{word} {told}: {ended}"
        );
    }
    let report = rig.ok("report");
    assert_eq!(
        report.stdout,
        text.join("\n") + "\n",
        "`ironbird report` says the same"
    );
    ended
}

#[test]
fn a_flight_in_lockstep_ends_with_what_matters() {
    let rig = Rig::new("lockstep");
    let ended = assert_brief(&rig, rig.ok("fly --pace lockstep --duration 500ms"));
    let ended = ended.says("\nTiming    NOT MEASURED: in lockstep there are no deadlines\n");
    let [name] = <[String; 1]>::try_from(rig.run_directories()).unwrap();
    let page = rig.out().join(&name).join("report.html");
    ended.says(&format!("\nPage      {}\n", page.display()));
    // Everything, and parts of it.
    let full = rig.ok("report --full");
    assert_eq!(
        full.stdout,
        fs::read_to_string(rig.out().join("latest/report.txt")).unwrap()
    );
    let mut parts = String::new();
    for part in report::render::flight::SECTION_NAMES {
        let said = rig.ok(&format!("report --section {part}")).stdout;
        assert!(!said.is_empty(), "{part}");
        parts += &(if parts.is_empty() {
            said
        } else {
            format!("\n{said}")
        });
    }
    assert_eq!(parts, full.stdout);
}

#[test]
fn a_long_path_keeps_its_ends_and_the_result_has_it_whole() {
    let rig = Rig::new("long-path");
    let out = rig
        .out()
        .join("of-a-rig-that-is-far-down-the-tree/".repeat(5));
    let out = out.to_str().unwrap();
    let ended = rig.ok(&format!("fly --pace lockstep --duration 100ms --out {out}"));
    let run = ended.result()["run"].clone();
    assert!(run.starts_with(out), "{run}");
    let page = ended
        .stdout
        .lines()
        .find(|line| line.starts_with("Page "))
        .unwrap();
    assert_eq!(page.chars().count(), 80, "{page}");
    let (head, tail) = page
        .strip_prefix("Page      ")
        .unwrap()
        .split_once("...")
        .unwrap();
    assert!(
        run.starts_with(head) && format!("{run}/report.html").ends_with(tail),
        "{page}"
    );
}

#[test]
fn what_there_is_no_room_for_is_left_to_the_full_report() {
    let rig = Rig::new("bad-day");
    rig.ok("fly --pace lockstep --duration 100ms");
    let path = rig.out().join("latest/report.json");
    let mut report = rig.report();
    let broken = serde_json::json!({"name": "a limit of some length", "limit": "<= 1", "value": "2", "held": false});
    report["verdict"]["gates"] = vec![broken; 12].into();
    let refused = |why: String| serde_json::json!({"step": "scheduler", "asked": 1, "granted": false, "refused": why});
    report["roles"]["plant"]["realtime"] = (0..9)
        .map(|i| refused(format!("reason {i} {}", "of many ".repeat(40))))
        .collect();
    fs::write(&path, report.to_string()).unwrap();
    let said = rig
        .ok("report")
        .says("\n          ... the rest: ironbird report --full\nLatencies [us] ")
        .stdout;
    assert_eq!(said.lines().count(), 29, "{said}");
    assert!(
        said.lines().all(|line| line.chars().count() <= 80) && said.contains("\nPage      "),
        "{said}"
    );
    // A sentence that is cut says so.
    report["verdict"]["gates"] = serde_json::json!([]);
    fs::write(&path, report.to_string()).unwrap();
    let said = rig.ok("report").stdout;
    let cut: Vec<&str> = said.lines().filter(|line| line.ends_with(" ...")).collect();
    assert!(cut.len() == 1 && cut[0].starts_with("          "), "{said}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_on_the_clock_ends_with_six_latencies_and_its_outages() {
    let rig = Rig::new("outages");
    let flight = rig.take_off("--rt off --duration 6s");
    let roles = flight.roles();
    for round in 0..20 {
        for role in ["plant", "outer", "inner", "mixer"] {
            stop_for(roles[role], Duration::from_millis(5 + round));
            sleep(Duration::from_millis(20));
        }
    }
    let ended = assert_brief(&rig, flight.end().expect(0));
    let ended = ended
        .says("\nTiming    ")
        .tells(" ticks without a fresh command on time (")
        .says("\nOutages   ")
        .tells("the longest: tick ");
    for series in [
        "loop",
        "slack",
        "wake.plant",
        "hop.plant_outer",
        "hop.outer_inner",
        "hop.inner_mixer",
    ] {
        assert!(
            ended.stdout.contains(&format!("\n  {series} ")),
            "{series}: {ended}"
        );
    }
    // The clock of this flight was the machine's, whatever that is worth.
    let head = rig.ok("report --section head");
    head.says("\nreal time here: not ");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_lost_an_interrupted_and_a_dead_flight_say_so_first() {
    let rig = Rig::new("lost");
    let fault = "--fault rotor_efficiency_1=0@100ms";
    let lost = rig.run("fly", format!("--pace lockstep --duration 5s {fault}"));
    let lost =
        assert_brief(&rig, lost.expect(3)).says("\n  FAIL flight envelope: left the envelope: ");
    assert!(
        lost.stdout
            .starts_with("Flight    LOST: left the envelope: "),
        "{lost}"
    );

    let flight = rig.take_off("--rt off --duration 600s");
    flight.signal(Signal::INT);
    assert_brief(&rig, flight.end().expect(130))
        .says("\nFlown     interrupted: trajectory lissajous");

    let flight = rig.take_off("--rt off --duration 600s");
    rig::wait_until("a report", || {
        rig.out().join("latest/report.json").exists().then_some(())
    });
    sleep(Duration::from_millis(1500));
    send(flight.roles()["inner"], Signal::KILL);
    let ended = assert_brief(&rig, flight.end().expect(1));
    ended
        .says("\nFlown     the inner process died: ")
        .says("\nGates     ABORTED\n");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_student_without_root_reads_what_was_refused_and_what_he_can_do() {
    let rig = Rig::new("student");
    let Some(ended) = fly_unprivileged(&rig, "--duration 1s") else {
        return;
    };
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

const LOCKSTEP: &str = "--pace lockstep --duration 100ms";

#[test]
fn settings_of_the_clock_have_no_effect_in_lockstep() {
    let rig = Rig::new("clockless");
    let config = rig.settings("[rt]\nlead_us = 250\nmode = \"prefer\"\n");
    rig.ok(&format!("fly {LOCKSTEP} --rt off --config {config}"));
}

#[test]
fn a_flight_in_lockstep_has_no_timer_and_its_mixer_no_tick_after_the_last() {
    let rig = Rig::new("timerless");
    rig.run("fly", LOCKSTEP).expect(0);
    let full = rig.ok("report --full");
    assert!(!full.stdout.contains("Lead "), "{full}");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(!page.contains("Lead none"), "the page");
    let replayed = rig.ok("replay");
    replayed
        .says("inner loop fresh 101, ")
        .says("mixer      fresh 101, held 0, fallback 0, idle 0, ");
    rig.run(
        "fly",
        format!("--rt off --config {} --duration 50ms", rig.slow(5)),
    );
    rig.run("report", "--full")
        .says("Lead none: the plant's timer is set to the beginning of the tick");
}

#[test]
fn a_schema_that_was_changed_is_damage_and_not_another_version() {
    let rig = Rig::new("flipped-schema");
    rig.run("fly", LOCKSTEP).expect(0);
    let log = rig.out().join("latest/flight.mcap");
    let mut bytes = fs::read(&log).unwrap();
    // A name of a field in the schema of the topic `state`, before the first chunk.
    let name = b"deadline_miss_run";
    let at = bytes
        .windows(name.len())
        .position(|window| window == name)
        .unwrap();
    bytes[at] ^= 1;
    fs::write(&log, bytes).unwrap();
    let refused = rig
        .run("replay", "")
        .expect(1)
        .complains("flight.mcap is damaged or no flight log: ");
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
    let error_m = |told: &str| -> f64 {
        let (_, rest) = told.split_once("largest ").unwrap();
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    assert!(
        error_m(&simulated.stdout) < 1.0,
        "fixes are off by 8 m, the flight is not: {simulated}"
    );
    rig.ok(&format!("fly --pace lockstep --config {noisy}"));
    let outputs = &simulated.result()["outputs"];
    rig.ok("replay --verify")
        .says(&format!("identical; outputs {outputs}\n"));
    let performance = rig.report()["flight"].clone();
    assert!(
        performance["position_error_max_m"].as_f64().unwrap() < 1.0,
        "{performance}"
    );
    assert!(
        performance["lowest_z_m"].as_f64().unwrap() > -1.0,
        "{performance}"
    );
    let (columns, rows) = states(&rig);
    let z = columns
        .iter()
        .position(|name| name.starts_with('z'))
        .unwrap();
    assert!(
        rows.iter().any(|row| row[z].abs() > 2.0),
        "states.csv has what is shown"
    );
}

/// The columns of states.csv, and its rows.
fn states(rig: &Rig) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = fs::read_to_string(rig.out().join("latest/states.csv")).unwrap();
    let mut lines = text.lines();
    let columns = lines
        .next()
        .unwrap()
        .split(',')
        .map(str::to_owned)
        .collect();
    (
        columns,
        lines
            .map(|line| {
                line.split(',')
                    .map(|cell| cell.parse().unwrap_or(f64::NAN))
                    .collect()
            })
            .collect(),
    )
}

#[test]
fn one_is_not_many() {
    let rig = Rig::new("one");
    let one = rig.ok("simulate --duration 1ms --fault mass_kg=0.55@tick0");
    one.says(": 2 ticks, ");
}
