//! What gates find: each broken by a real flight, or passed by one, and what became of it in JUnit XML.

use crate::rig::{Ended, Rig, Running, lacks_tool, stop_for};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

/// Limits that nothing breaks that was measured.
const GENEROUS: [&str; 14] = [
    "--max-miss-rate",
    "1e9",
    "--max-skip-rate",
    "1e9",
    "--max-stale-rate",
    "1e9",
    "--max-wake-p999",
    "1e9",
    "--max-loop-p999",
    "1e9",
    "--max-tracking-error",
    "1e9",
    "--max-steal",
    "100",
];

/// A gate of the newest flight.
fn gate(rig: &Rig, name: &str) -> Value {
    let gates = rig.report()["verdict"]["gates"].clone();
    gates
        .as_array()
        .unwrap()
        .iter()
        .find(|gate| gate["name"] == name)
        .unwrap_or_else(|| panic!("{gates}"))
        .clone()
}

/// What a gate found that must not have held, and that the flight ends with.
fn failed(rig: &Rig, ended: &Ended, name: &str) -> String {
    let gate = gate(rig, name);
    assert_eq!(gate["held"], false, "{gate}");
    let value = gate["value"].as_str().unwrap().to_owned();
    assert!(
        ended.stdout.contains(&format!("\n  FAIL {name}: ")),
        "{ended}"
    );
    value
}

/// A flight that a gate has failed.
fn expect_failed(rig: &Rig, ended: Ended) -> Ended {
    let ended = ended.expect(3);
    assert_eq!(ended.result()["status"], "FAIL", "{ended}");
    rig.assert_nothing_left();
    ended
}

/// A number of a gate, without what stands behind it.
fn number(value: &str) -> f64 {
    value
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap_or_else(|_| panic!("{value}"))
}

fn stop(flight: &Running, role: &str) {
    stop_for(flight.roles()[role], Duration::from_millis(150));
}

#[test]
fn an_inner_loop_that_stops_fails_the_miss_rate() {
    let rig = Rig::new("stopped");
    let flight = ["--duration", "1500ms", "--max-miss-rate", "0"];
    let fault = ["--fault", "inner.stop=100ms@1s"];
    let ended = rig.run("fly", [&flight[..], &fault].concat());
    let ended = expect_failed(&rig, ended);
    let value = failed(&rig, &ended, "ticks without a fresh command per million");
    assert!(number(&value) > 10_000.0, "{value}");
    let not_fresh = rig.report()["deadlines"]["not_fresh"].clone();
    let of = |key: &str| not_fresh[key].as_u64().unwrap();
    assert!(of("stale") > 20, "{not_fresh}");
    assert_eq!(of("ticks"), of("missed") + of("stale") + of("skipped"));
    rig.run("runs", &[] as &[&str])
        .expect(0)
        .says(&format!(" {} ", of("ticks")));
}

#[test]
#[ignore = "long: part of the gate"]
fn missed_skipped_and_stale_ticks_fail_their_gates() {
    let rig = Rig::new("rates");
    let slow = rig.slow(20);
    let gates = [
        "--max-miss-rate",
        "0",
        "--max-skip-rate",
        "0",
        "--max-stale-rate",
        "0",
    ];
    let args = [
        &["--rt", "off", "--config", &slow, "--duration", "150ms"],
        &gates[..],
    ]
    .concat();
    let flight = rig.take_off(&args);
    // The plant waits for tick 0 at most 0.2 s after it is announced: by then it flies.
    sleep(Duration::from_millis(300));
    for role in ["mixer", "plant", "inner"] {
        stop(&flight, role);
        sleep(Duration::from_millis(100));
    }
    let ended = expect_failed(&rig, flight.end());
    assert_eq!(ended.result()["gates"], "0/3", "{ended}");
    for name in [
        "ticks without a fresh command per million",
        "ticks skipped per million",
        "stale ticks per million",
    ] {
        let value = failed(&rig, &ended, name);
        assert!(number(&value) > 10_000.0, "{name}: {value}");
    }
    let value = failed(&rig, &ended, "stale ticks per million");
    assert!(
        value.ends_with(" (inner)") || value.ends_with(" (mixer)"),
        "of the stage that has most: {value}"
    );
    let report = rig.report();
    let deadlines = &report["deadlines"];
    assert!(
        deadlines["missed"].as_u64().unwrap() >= 5
            && deadlines["missed_by_stamps"].as_u64().unwrap() >= 5
    );
    let runs = deadlines["runs"].as_array().unwrap();
    assert!(
        runs.iter()
            .any(|run| run["length_ticks"].as_u64().unwrap() >= 5),
        "misses in a row: {runs:?}"
    );
    assert!(
        report["ticks"]["skipped"].as_u64().unwrap() >= 5,
        "{}",
        report["ticks"]
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn latencies_and_tracking_fail_gates_that_are_too_narrow_and_hold_wide_ones() {
    const NAMES: [&str; 3] = [
        "wake.plant p99.9 [us]",
        "loop p99.9 [us]",
        "position error in the last 5 s [m]",
    ];
    let rig = Rig::new("narrow");
    let fly = |limit: &str| {
        let gates =
            format!("--max-wake-p999 {limit} --max-loop-p999 {limit} --max-tracking-error {limit}");
        // Ten thousand values are not too few, even where ticks are skipped.
        rig.run("fly", format!("--rt off --duration 14s {gates}"))
    };
    let ended = expect_failed(&rig, fly("1e-9"));
    assert_eq!(ended.result()["gates"], "0/3", "{ended}");
    for name in NAMES {
        assert!(number(&failed(&rig, &ended, name)) > 1e-9);
    }
    let ended = fly("1e9")
        .expect(0)
        .says("\nGates     PASS: 3 of 3 gates held\n");
    assert_eq!(ended.result()["gates"], "3/3", "{ended}");
    let report = rig.report();
    let of = |name: &str| number(gate(&rig, name)["value"].as_str().unwrap());
    let p999 = |name: &str| {
        let series = report["series"].as_array().unwrap();
        series.iter().find(|series| series["name"] == name).unwrap()["p999_us"]
            .as_f64()
            .unwrap()
    };
    assert!(
        (of(NAMES[0]) - p999("wake.plant")).abs() < 0.06
            && (of(NAMES[1]) - p999("loop")).abs() < 0.06
    );
    assert!((of(NAMES[2]) - report["flight"]["recent_error_max_m"].as_f64().unwrap()).abs() < 6e-5);
}

#[test]
fn a_gate_that_measured_nothing_fails() {
    let rig = Rig::new("nothing");
    let args = [
        &["--pace", "lockstep", "--duration", "200ms"],
        &GENEROUS[..],
    ]
    .concat();
    let ended = expect_failed(&rig, rig.run("fly", &args));
    // The states and the kernel's counters are there in lockstep as well.
    assert_eq!(ended.result()["gates"], "2/7", "{ended}");
    for name in [
        "ticks without a fresh command per million",
        "ticks skipped per million",
        "stale ticks per million",
        "wake.plant p99.9 [us]",
        "loop p99.9 [us]",
    ] {
        assert_eq!(
            failed(&rig, &ended, name),
            "measured nothing: in lockstep there are no deadlines",
            "{name}"
        );
    }
    assert!(number(gate(&rig, "steal [%]")["value"].as_str().unwrap()) >= 0.0);
    let short = format!(
        "--rt off --config {} --duration 50ms --max-loop-p999 1e9",
        rig.slow(5)
    );
    let ended = expect_failed(&rig, rig.run("fly", &short));
    let value = failed(&rig, &ended, "loop p99.9 [us]");
    assert!(
        value.starts_with("measured nothing: too few values for p99.9: "),
        "{value}"
    );
}

#[test]
fn a_theorem_that_nothing_is_learned_under_does_not_pass_for_one_that_holds() {
    let rig = Rig::new("pinned");
    let pinned =
        rig.settings("[inner]\nestimate_min = [0.0, 0.0, 0.0]\nestimate_max = [0.0, 0.0, 0.0]\n");
    let args = format!("--config {pinned} --duration 500ms --gate theorem");
    let why = "measured nothing: no estimate moved: adaptation is off, or its bounds pin it";
    let ended = expect_failed(&rig, rig.run("fly", format!("--pace lockstep {args}")));
    assert_eq!(failed(&rig, &ended, "theorem"), why);
    assert_eq!(
        (&ended.result()["theorem"], &ended.result()["gates"]),
        (&"not-applicable".into(), &"0/1".into())
    );
    let simulated = rig
        .run("simulate", &args)
        .expect(3)
        .says(&format!("\nFAIL theorem: {why} (limit "));
    assert_eq!(simulated.result()["gates"], "0/1", "{simulated}");
}

#[test]
fn a_pass_says_how_many_gates_were_asked_for() {
    let rig = Rig::new("asked");
    let lockstep = ["--pace", "lockstep", "--duration", "200ms"];
    let ended = rig
        .run("fly", lockstep)
        .expect(0)
        .says("\nGates     PASS: no gate was asked for\n");
    assert_eq!(
        (&ended.result()["status"], &ended.result()["gates"]),
        (&"PASS".into(), &"0/0".into())
    );
    let args = [
        &lockstep[..],
        &["--gate", "theorem", "--max-tracking-error", "1"],
    ]
    .concat();
    let ended = rig
        .run("fly", &args)
        .expect(0)
        .says("\nGates     PASS: 2 of 2 gates held\n");
    assert_eq!(ended.result()["gates"], "2/2", "{ended}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_leaves_its_envelope_fails_flown_or_simulated() {
    let rig = Rig::new("envelope");
    for (fault, limits, simulated, flown) in [
        (
            "rotor_efficiency_1=0@tick50",
            "position_error_max_m = 0.01\n",
            "the position error is 0.01 m",
            "position error beyond its limit",
        ),
        (
            "rotational_drag_nm_s=0,rotor_efficiency_1=0@tick5",
            "position_error_max_m = 100.0\ntilt_max_rad = 1.396\n",
            "the tilt is 8",
            "tilt beyond its limit",
        ),
        (
            "rotor_efficiency_1=0,rotor_efficiency_3=0@tick5",
            "position_error_max_m = 100.0\n[ground]\ncontact = \"plane\"\ncrash_speed_m_s = 0.5\n",
            "it crashed, at ",
            "crashed into the ground",
        ),
    ] {
        let settings = rig.settings(&format!("[flight]\nslowdown = 2\n{limits}"));
        let args = format!("--config {settings} --duration 2s --fault {fault}");
        let ended = rig
            .run("simulate", &args)
            .expect(3)
            .says("the flight left its envelope: at tick ")
            .says(simulated);
        assert_eq!(ended.result()["status"], "FAIL");
        let ended = expect_failed(&rig, rig.run("fly", format!("{args} --rt off")));
        let value = failed(&rig, &ended, "flight envelope");
        assert_eq!(value, format!("left the envelope: {flown}"));
        let report = rig.report();
        let ticks = report["ticks"]["run"].as_u64().unwrap();
        assert!(
            report["ticks"]["identity_holds"] == true && (51..2001).contains(&ticks),
            "{ticks} ticks"
        );
    }
}

/// A JUnit file as a CI server reads it: of each test case its name, outcome and message; properties by name.
fn junit(path: &str) -> Option<Value> {
    const READ: &str = "\
import json, sys, xml.etree.ElementTree as tree
root = tree.parse(sys.argv[1]).getroot()
suite = root.find('testsuite')
outcomes = ('failure', 'error')
cases = [[case.get('name')] + [[it.tag, it.get('message')] for it in case if it.tag in outcomes]
         for case in suite.iter('testcase')]
properties = {it.get('name'): it.get('value') for it in suite.findall('properties/property')}
counts = [int(root.get(key)) for key in ('tests', 'failures', 'errors')]
print(json.dumps({'cases': cases, 'properties': properties, 'counts': counts}))";
    let python = std::env::var("IRONBIRD_PYTHON").unwrap_or_else(|_| "python3".into());
    let Ok(output) = Command::new(python).args(["-c", READ, path]).output() else {
        lacks_tool("no JUnit file is read: there is no python3");
        return None;
    };
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn a_ci_server_reads_the_gates_as_tests() {
    let rig = Rig::new("junit");
    let (flown, told) = (rig.file("flown.xml"), rig.file("told.xml"));
    let gates = [
        "--gate",
        "theorem",
        "--max-miss-rate",
        "7",
        "--junit",
        &flown,
    ];
    let args = [&["--pace", "lockstep", "--duration", "200ms"], &gates[..]].concat();
    rig.run("fly", &args).expect(3);
    let Some(read) = junit(&flown) else { return };
    // The end, two gates of every flight, two that were asked for.
    assert_eq!(read["counts"], serde_json::json!([5, 1, 0]), "{read}");
    let why = "measured nothing: in lockstep there are no deadlines (limit <= 7)";
    let missed = serde_json::json!([
        "ticks without a fresh command per million",
        ["failure", why]
    ]);
    assert!(
        read["cases"].as_array().unwrap().contains(&missed),
        "{read}"
    );
    let words = ["flight", "timing", "theorem", "status"]
        .map(|name| read["properties"][name].as_str().unwrap());
    assert_eq!(words, ["tracked", "not measured", "holds", "FAIL"]);
    for with in [&[][..], &["--open"]] {
        let mut command = rig.command("report", [&["--junit", &told], with].concat());
        command.env("BROWSER", "true");
        rig.launch(command).end().expect(0);
        assert_eq!(
            fs::read_to_string(&told).unwrap(),
            fs::read_to_string(&flown).unwrap()
        );
        fs::remove_file(&told).unwrap();
    }
}

#[test]
fn a_flight_that_did_not_come_to_its_end_is_no_passed_test() {
    let rig = Rig::new("no-pass");
    let file = rig.file("j.xml");
    fs::write(&file, "of yesterday").unwrap();
    let flight = rig.take_off(format!("--rt off --duration 600s --junit {file}"));
    flight.signal(Signal::INT);
    flight.end().expect(130);
    let Some(read) = junit(&file) else { return };
    let interrupted =
        serde_json::json!(["end of the flight", ["error", "INTERRUPTED: interrupted"]]);
    assert_eq!(read["cases"][0], interrupted, "{read}");
    fs::write(&file, "of yesterday").unwrap();
    for (refused, words) in [
        (["--out", "/proc/nope"], "cannot record into /proc/nope"),
        (["--cpu", "1023"], "rt.cpu = 1023: "),
        (
            ["--config", "/proc/nope"],
            "cannot read the settings file /proc/nope",
        ),
        (
            ["--states", "/nowhere/states.csv"],
            "--states: cannot write /nowhere/states.csv",
        ),
    ] {
        fs::write(&file, "of yesterday").unwrap();
        rig.run(
            "fly",
            [&["--rt", "off", "--junit", &file], &refused[..]].concat(),
        )
        .expect(2);
        let read = junit(&file).unwrap();
        assert_eq!(read["counts"], serde_json::json!([1, 0, 1]), "{read}");
        let why = read["cases"][0][1][1].as_str().unwrap();
        assert!(why.starts_with(words), "{why}");
    }
}
