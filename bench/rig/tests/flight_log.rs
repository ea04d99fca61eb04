//! The flight log: what it holds and keeps, in which files, and what exports and other readers make of it.

use crate::python::{python_with, run_python};
use crate::rig::{Ended, Rig, not_tested, read_log, send, stop_for, wait_until};
use flight_log::TOPICS;
use flight_log::entry::LogEntry;
use flight_log::facts::{Facts, LogPlan, record};
use flight_log::reader::End;
use flight_log::telemetry::TELEMETRY_TOPICS;
use flight_log::writer::FlightLog;
use messages::content::Wrench;
use messages::grid::Pace;
use messages::header::Message;
use messages::role::Role;
use messages::telemetry::Signals;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

fn latest(rig: &Rig, file: &str) -> PathBuf {
    rig.out().join("latest").join(file)
}

fn read_file(rig: &Rig, file: &str) -> String {
    fs::read_to_string(latest(rig, file)).unwrap()
}

/// A count in a JSON text.
fn count(value: &Value, pointer: &str) -> u64 {
    let number = value.pointer(pointer).and_then(Value::as_u64);
    number.unwrap_or_else(|| panic!("no count at {pointer} of {value}"))
}

/// Sum over all topics of a report's log, such as of `dropped`.
fn sum(report: &Value, counts: &str) -> u64 {
    let counts = &report["recorder"]["log"][counts];
    TOPICS
        .iter()
        .map(|topic| count(counts, &format!("/{topic}")))
        .sum()
}

fn ticks(entries: &[LogEntry], topic: &str) -> Vec<u64> {
    let of_topic = entries
        .iter()
        .filter(|entry| TOPICS[entry.topic()] == topic);
    of_topic.map(|entry| entry.envelope().tick).collect()
}

fn log_files(rig: &Rig) -> Vec<String> {
    let names = fs::read_dir(latest(rig, "")).unwrap();
    let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name.ends_with(".mcap")).collect();
    names.sort();
    names
}

#[test]
fn every_message_is_in_the_log_and_others_read_the_same_numbers() {
    let rig = Rig::new("log");
    rig.ok(
        "fly --pace lockstep --duration 1500ms --fault gyro_noise_rad_s=0.01@tick100 \
         --fault mass_kg=0.6,rotational_drag_nm_s=0.5@tick1500",
    );
    let (log, report) = (latest(&rig, "flight.mcap"), rig.report());
    let (entries, end) = read_log(&log);
    assert_eq!(end, End::Complete);
    // The mixer publishes idle speeds after landing; the second parameter change holds from the last tick on.
    let counts = [1501, 1501, 1501, 1502, 2, 1501];
    for (topic, messages) in TOPICS.iter().zip(counts) {
        assert_eq!(ticks(&entries, topic).len() as u64, messages, "{topic}");
        let section = &report["recorder"]["log"];
        assert_eq!(section["messages"][topic], messages, "{topic}");
        assert_eq!(section["dropped"][topic], 0, "{topic}");
    }
    let section = &report["recorder"]["log"];
    assert_eq!(section["file_bytes"], fs::metadata(&log).unwrap().len());
    assert!(section["refused"].is_null(), "{section}");
    others_read_the_same(&rig, counts);
    exports_are_whole_and_say_what_is_there(&rig);
}

fn others_read_the_same(rig: &Rig, counts: [u64; TOPICS.len()]) {
    let (log, exported) = (latest(rig, "flight.mcap"), rig.path("exported"));
    rig.ok(&format!("export --format json --to {}", exported.display()))
        .says("1502 messages")
        .says("rotor_speeds.jsonl");
    let packages = "matplotlib, mcap.reader, mcap_protobuf.decoder";
    let purpose = "flight.mcap is not read by another implementation";
    let Some(python) = python_with(packages, purpose) else {
        return;
    };
    let picture = rig.path("flight.png");
    run_python(&python, "docs/plot_flight.py", &[&log, &picture]);
    assert!(fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
    let read = run_python(&python, "bench/rig/tests/read_mcap.py", &[&log, &exported]);
    let read: Value = serde_json::from_slice(&read).unwrap();
    let channels = &read["channels"];
    for (topic, messages) in TOPICS.iter().zip(counts) {
        assert_eq!(channels[topic]["messages"], messages, "{topic}");
    }
    for (topic, stage) in TELEMETRY_TOPICS
        .iter()
        .zip(["setpoint", "wrench", "rotor_speeds"])
    {
        assert_eq!(channels[topic]["messages"], channels[stage]["messages"]);
        assert_eq!(channels[stage]["metadata"]["telemetry"], **topic);
        let first = read["first"][stage].as_str().unwrap();
        assert!(!first.contains("telemetry"), "{first}");
    }
    let version = concat!("/records/run/version = ", env!("CARGO_PKG_VERSION"));
    for fact in [
        "/channels/state/schema = ironbird.State",
        "/channels/state/metadata/unit.measured.velocity_w_m_s = m/s",
        "/channels/state/metadata/frame.measured.velocity_w_m_s = world: right-handed, z up",
        "/channels/inner_telemetry/schema = ironbird.InnerTelemetry",
        "/channels/inner_telemetry/metadata/unit.rotational_drag_nm_s = N m s",
        "/channels/mixer_telemetry/metadata/unit.yaw_share = 1",
        "/channels/pose~1actual/schema = foxglove.PoseInFrame",
        "/channels/pose~1reference/schema = foxglove.PoseInFrame",
        "/channels/transforms/schema = foxglove.FrameTransform",
        "/records/landing/ending = completed",
        version,
    ] {
        let (pointer, expected) = fact.split_once(" = ").unwrap();
        assert_eq!(read.pointer(pointer).unwrap(), expected, "{fact}");
    }
    for topic in ["pose/actual", "pose/reference", "transforms"] {
        assert!(count(&channels[topic], "/messages") >= 38, "{topic}");
    }
    let pose = read["first"]["pose/actual"].as_str().unwrap();
    assert!(pose.contains("frame_id: \"world\""), "{pose}");
    let records = &read["records"];
    assert_eq!(
        records["settings"]["settings.toml"],
        read_file(rig, "settings.toml")
    );
    let shared = records["settings"]["shared"].as_str().unwrap();
    assert!(shared.contains("inner.alpha_1_s = 200.0\n"), "{shared}");
    assert_eq!(records["host"]["kernel"], rig.report()["host"]["kernel"]);
    assert!(records["realtime"]["plant"].is_string(), "{records}");
}

fn exports_are_whole_and_say_what_is_there(rig: &Rig) {
    rig.ok("export")
        .says("    1501 messages")
        .says("latest/export/state.csv");
    let mut csv = csv::Reader::from_path(latest(rig, "export/state.csv")).unwrap();
    let z = csv
        .headers()
        .unwrap()
        .iter()
        .position(|name| name == "measured.position_w_m[2]");
    // Every row has as many columns as the header, or the reader fails.
    let rows: Vec<_> = csv.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 1501);
    let states = read_file(rig, "states.csv");
    let tick_150 = states.lines().nth(4).unwrap();
    let [exported, z] = [&rows[150][z.unwrap()], tick_150.split(',').nth(3).unwrap()]
        .map(|value| value.parse::<f64>().unwrap().to_bits());
    assert_eq!(exported, z);
    let swaps = rig.ok("export --topic swaps --format json").stdout;
    let second: Value = serde_json::from_str(swaps.lines().nth(1).unwrap()).unwrap();
    assert_eq!(second["envelope"]["tick"], 1500);
    assert_eq!(second["new"][0], 0.6);
    // It ends quietly when nobody reads on.
    let script = "\"$@\" | head -1; exit ${PIPESTATUS[0]}";
    let by = ["bash", "-c", script, "bash"];
    let export = rig.command_by(&by, "export", "--topic rotor_speeds");
    let ended = rig.launch(export).end().expect(0);
    assert_eq!(
        (ended.stdout.lines().count(), ended.stderr.as_str()),
        (1, "")
    );
    rig.refused("export --topic wrenches")
        .complains("rotor_speeds")
        .complains("wrench");
    rig.refused("export nowhere")
        .complains("no flight at nowhere")
        .complains(&rig.run_directories()[0]);
    fs::remove_file(latest(rig, "flight.mcap")).unwrap();
    rig.refused("export")
        .complains("holds no flight.mcap; it holds: export")
        .complains("report.json");
    rig.refused("replay --verify")
        .complains("holds no flight.mcap");
    let random = rig.file("random.mcap");
    fs::write(&random, "no log\n").unwrap();
    for command in ["export", "replay"] {
        let ended = rig.run(command, &random).expect(1);
        ended.complains("random.mcap is damaged or no flight log");
    }
}

#[test]
fn a_trace_shows_every_tick_of_every_stage_every_miss_and_every_swap() {
    let rig = Rig::new("trace");
    let flight = rig.take_off(format!(
        "--rt off --duration 3s --fault rotational_drag_nm_s=0.2@tick200 --config {}",
        rig.airborne("")
    ));
    // Deadlines are missed on purpose, and in flight.
    rig.await_tick(0);
    stop_for(flight.roles()["mixer"], Duration::from_millis(50));
    flight.end().expect(0);
    rig.ok("export --format perfetto")
        .says("latest/flight.perfetto-trace");
    rig.refused("export --format perfetto --topic state")
        .complains("not one topic");
    let Some(python) = python_with("perfetto.protos", "no trace is read") else {
        return;
    };
    let trace = latest(&rig, "flight.perfetto-trace");
    let read = run_python(&python, "bench/rig/tests/read_perfetto.py", &[&trace]);
    let read: Value = serde_json::from_slice(&read).unwrap();
    assert_eq!(
        read["tracks"],
        json!([
            "ironbird",
            "plant",
            "outer",
            "inner",
            "mixer",
            "deadlines missed",
            "swaps"
        ])
    );
    let mut slices = BTreeMap::<Role, Vec<Value>>::new();
    let (entries, _) = read_log(&latest(&rig, "flight.mcap"));
    for entry in &entries {
        let role = match TOPICS[entry.topic()] {
            "state" => Role::Plant,
            "setpoint" => Role::Outer,
            "wrench" => Role::Inner,
            "rotor_speeds" => Role::Mixer,
            _ => continue,
        };
        let header = entry.envelope();
        let stamps = header.stamps_of(role);
        let is_stale = role != Role::Plant && header.input_tick[role as usize - 1] != header.tick;
        let name = format!("{role}{}", if is_stale { " (stale input)" } else { "" });
        if stamps.receive_ns > 0 {
            let slice = json!([header.tick, stamps.receive_ns, stamps.send_ns, name]);
            slices.entry(role).or_default().push(slice);
        }
    }
    for (role, slices) in slices {
        assert!(slices.len() > 100, "{role}: {}", slices.len());
        assert_eq!(read["slices"][role.name()], Value::from(slices), "{role}");
    }
    let instants = |track: &str| {
        let all = read["instants"].as_array().unwrap().iter();
        all.filter(|instant| instant[0] == track)
            .collect::<Vec<_>>()
    };
    let missed = instants("deadlines missed").into_iter();
    let missed: u64 = missed.map(|instant| count(instant, "/2/count")).sum();
    // Misses before the first state, and after the last state, are in no state.
    let reported = count(&rig.report(), "/deadlines/missed");
    assert!((21..=reported).contains(&missed), "{missed} of {reported}");
    let [swap] = instants("swaps")[..] else {
        panic!("{read}")
    };
    assert_eq!(swap[2]["rotational_drag_nm_s"], "0.105 -> 0.2");
}

#[test]
fn an_export_says_what_a_log_has_no_topic_and_no_message_of() {
    let rig = Rig::new("silent");
    let path = rig.path("silent.mcap");
    let facts = Facts {
        pace: Pace::Lockstep,
        sample_time_ns: 1_000_000,
        plan: LogPlan::WHOLE,
        signals: Signals::default(),
        no_theorem: None,
        records: Vec::new(),
    };
    let mut log = FlightLog::create(&path, &facts).unwrap();
    let mut wrench = Message::<Wrench>::default();
    wrench.content.thrust_n = 5.0;
    log.take(LogEntry::Wrench(wrench));
    log.finish(record(&[])).unwrap();
    assert_eq!(read_log(&path).0, [LogEntry::Wrench(wrench)]);
    let (path, tables) = (path.display(), rig.path("tables"));
    rig.refused(&format!("export {path} --topic inner_telemetry")).complains(
        "silent.mcap has no topic inner_telemetry: the inner law of this flight publishes no signals",
    );
    let exported = rig.ok(&format!("export {path} --to {}", tables.display()));
    let exported = exported.says("1 messages").says("wrench.csv").stdout;
    assert!(!exported.contains("telemetry"), "{exported}");
    // The columns are named even if there is no row.
    let swaps = fs::read_to_string(tables.join("swaps.csv")).unwrap();
    assert!(swaps.starts_with("envelope.layout,") && swaps.contains("parameter_epoch"));
    assert_eq!(swaps.lines().count(), 1, "{swaps}");
    let printed = rig.ok(&format!("export {path} --topic swaps"));
    assert_eq!(printed.stdout, swaps);
    let printed = rig.ok(&format!("export {path} --topic swaps --format json"));
    assert_eq!(printed.stdout, "");
}

#[test]
fn a_killed_recorder_leaves_what_it_had_written() {
    let rig = Rig::new("killed-log");
    let flight = rig.take_off(format!("--rt off --config {} --duration 1h", rig.slow(5)));
    let recorder = flight.roles()["record"];
    let log = latest(&rig, "flight.mcap");
    wait_until("some chunks", || {
        (fs::metadata(&log).ok()?.len() > 400_000).then_some(())
    });
    send(recorder, Signal::KILL);
    flight.end().expect(1);
    let (entries, end) = read_log(&log);
    let states = ticks(&entries, "state").len();
    assert!(end == End::Truncated && states > 100, "{states} states");
    let exported = rig.ok("export --topic state").complains("is truncated");
    assert_eq!(exported.stdout.lines().count(), states + 1);
    rig.run("replay", "--verify")
        .expect(1)
        .complains("is truncated")
        .complains("ticks agree in");
    let replayed = rig.run("replay", "").expect(1);
    let replayed = replayed
        .says("ticks replayed")
        .complains("is truncated")
        .complains("ticks agree in")
        .complains("only a complete log can be verified");
    assert!(
        !replayed.stdout.contains("agrees with the record"),
        "{replayed}"
    );
}

/// A flight whose directory lies on a disk of `size`, in a mount namespace of its own, which is copied to `kept`.
fn fly_on_a_small_disk(rig: &Rig, size: &str, args: &str) -> Option<Ended> {
    let mount = Command::new("unshare")
        .args(["-m", "mount", "-t", "tmpfs", "none", "/mnt"])
        .output();
    if !mount.is_ok_and(|output| output.status.success()) {
        not_tested("a full disk: this needs a mount namespace (root)");
        return None;
    }
    let (disk, kept) = (rig.file("disk"), rig.file("kept"));
    fs::create_dir(&disk).unwrap();
    let script = "mount -t tmpfs -o size=$1 none $2; at=$2; kept=$3; shift 3; \"$@\"; code=$?; \
        cp -rL $at/latest $kept; exit $code";
    let by = [
        "unshare", "-m", "sh", "-c", script, "sh", size, &disk, &kept,
    ];
    let mut flight = rig.command_by(&by, "fly", format!("{args} --out {disk}"));
    flight.process_group(0);
    Some(rig.launch(flight).end())
}

#[test]
#[ignore = "long: part of the gate"]
fn a_full_disk_costs_messages_and_not_the_flight() {
    // The second disk has no room for any message.
    for size in ["7m", "3m"] {
        let rig = Rig::new("full");
        let options = "--pace lockstep --duration 12s";
        let Some(ended) = fly_on_a_small_disk(&rig, size, options) else {
            return;
        };
        // The gates were judged during the flight.
        let ended = ended.expect(0);
        let result = ended.result();
        let unlogged: u64 = result["unlogged"].parse().unwrap();
        assert_eq!(
            (result["status"].as_str(), result["ticks"].as_str()),
            ("INCOMPLETE", "12001")
        );
        assert!(unlogged > 1000 && result["lost"] == "0", "{result:?}");
        let report = fs::read_to_string(rig.path("kept/report.json")).unwrap();
        let report: Value = serde_json::from_str(&report).unwrap();
        assert_eq!(report["verdict"]["status"], "INCOMPLETE");
        let section = &report["recorder"]["log"];
        if size == "3m" {
            assert_eq!(section["messages"]["state"], 0);
            continue;
        }
        let ended = ended.tells("less than 4 MiB would be left free on the disk");
        let missing = format!("INCOMPLETE RECORD: flight.mcap lacks {unlogged} ");
        let mut head = ended.stdout.lines().take(9);
        assert!(head.any(|line| line.starts_with(&missing)), "{ended}");
        for topic in ["state", "setpoint", "wrench"] {
            let [dropped, logged] =
                ["dropped", "messages"].map(|counts| count(section, &format!("/{counts}/{topic}")));
            assert!(dropped > 1000 && logged > 1000, "{section}");
            assert_eq!(dropped + logged, 12_001, "{topic}");
        }
        let log = rig.path("kept/flight.mcap");
        let (entries, end) = read_log(&log);
        assert_eq!(end, End::Truncated);
        for topic in ["state", "rotor_speeds"] {
            assert_eq!(section["messages"][topic], ticks(&entries, topic).len());
        }
        assert_eq!(section["file_bytes"], fs::metadata(&log).unwrap().len());
        assert_eq!(report["recorder"]["unwritten"], json!({}));
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_disk_without_room_for_the_report_does_not_make_up_a_log() {
    for size in ["100k", "200k"] {
        let rig = Rig::new("no-report");
        let Some(ended) = fly_on_a_small_disk(&rig, size, "--rt off --duration 3s") else {
            return;
        };
        let ended = ended.expect(1).says("ABORTED").says("the recorder died");
        rig.ok(&format!("report {} --section processes", rig.file("kept")))
            .says(" 0 messages in 0.0 MB, ");
        assert_ne!(ended.result()["unlogged"], "0", "{size}: {ended}");
        ended.says("\nINCOMPLETE RECORD: flight.mcap lacks ");
        let log = fs::metadata(rig.path("kept/flight.mcap")).unwrap();
        assert_eq!(log.len(), 0, "{size}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_disk_without_room_for_what_a_role_says_is_no_panic() {
    for size in ["4k", "8k", "12k", "16k", "20k", "24k", "32k"] {
        let rig = Rig::new("speechless");
        let Some(ended) = fly_on_a_small_disk(&rig, size, "--rt off --duration 300ms") else {
            return;
        };
        assert!(matches!(ended.code, Some(1 | 2)), "{size}: {ended}");
        let has = |words: &str| ended.stderr.contains(words) || ended.stdout.contains(words);
        let is_named = has("No space left on device") || has("the disk is full, and had no room");
        assert!(is_named, "{size}: {ended}");
        assert!(
            !has("has what was recorded") && !has("status: 101"),
            "{size}: {ended}"
        );
        rig.assert_nothing_left();
    }
}

#[test]
fn an_excerpt_holds_take_off_swaps_and_landing_and_says_that_it_is_one() {
    let rig = Rig::new("excerpt");
    let config = rig.settings("[recorder]\nlog_around_s = 0.05\n");
    rig.ok(&format!(
        "fly --pace lockstep --duration 1s --fault mass_kg=0.6@tick500 --config {config} --log around-misses"
    ));
    let (entries, end) = read_log(&latest(&rig, "flight.mcap"));
    assert_eq!(end, End::Complete);
    let expected: Vec<u64> = (0..=50).chain(450..=550).chain(950..=1000).collect();
    for topic in ["state", "setpoint", "wrench", "theorem"] {
        assert_eq!(ticks(&entries, topic), expected, "{topic}");
    }
    assert_eq!(ticks(&entries, "swaps"), [500]);
    let report = rig.report();
    let log = &report["recorder"]["log"];
    assert_eq!(log["kept"], "around-misses");
    assert_eq!((count(log, "/stretches"), count(log, "/files")), (3, 1));
    // A message that was not to be kept is not missing.
    assert_eq!(sum(&report, "left_out"), 5 * (1001 - 203), "{log}");
    assert_eq!(sum(&report, "dropped"), 0, "{log}");
    assert_eq!(sum(&report, "messages"), entries.len() as u64);
    assert_eq!(report["verdict"]["status"], "PASS");
    let text = read_file(&rig, "report.txt");
    let excerpts = "; 3 excerpts kept, 3990 left out as asked\n";
    assert!(text.contains(excerpts), "{text}");
    let exported = rig.ok("export --topic state");
    let exported = exported
        .complains("contains excerpts: 50 ticks before")
        .stdout;
    assert_eq!(exported.lines().count(), 1 + expected.len());
    for verify in ["--verify", ""] {
        let refused = rig.run("replay", verify).expect(1);
        let refused = refused
            .complains("cannot be replayed: it keeps excerpts, 50 ticks")
            .complains("fly --log all");
        assert_eq!(refused.stdout, "");
    }
}

#[test]
fn a_flight_without_a_log_has_a_report_and_says_why_there_is_no_more() {
    let rig = Rig::new("no-log");
    let result = rig
        .ok("fly --pace lockstep --duration 1s --log off")
        .result();
    for (key, value) in [("status", "PASS"), ("unlogged", "0"), ("ticks", "1001")] {
        assert_eq!(result[key], value, "{result:?}");
    }
    assert_eq!(log_files(&rig), Vec::<String>::new());
    let text = read_file(&rig, "report.txt");
    let none = "flight.mcap: none, as asked (recorder.log = off)\n";
    assert!(text.contains(none), "{text}");
    assert_ne!(read_file(&rig, "latency.hlog"), "");
    for command in ["export", "replay"] {
        rig.refused(command)
            .complains("holds no flight.mcap: it was flown with recorder.log")
            .complains("`fly --log all` logs every message");
    }
}

#[test]
fn a_long_log_goes_on_in_further_files_and_is_read_as_one() {
    let rig = Rig::new("files");
    let config = rig.settings("[recorder]\nlog_file_mb = 2\n");
    let fly = format!("fly --pace lockstep --duration 8s --config {config}");
    rig.ok(&fly);
    let (report, names) = (rig.report(), log_files(&rig));
    let log = &report["recorder"]["log"];
    assert!(
        names.len() > 2 && log["files"] == names.len(),
        "{names:?} {log}"
    );
    let bytes = names
        .iter()
        .map(|name| fs::metadata(latest(&rig, name)).unwrap().len());
    assert_eq!(log["file_bytes"], bytes.sum::<u64>());
    let (entries, end) = read_log(&latest(&rig, "flight.mcap"));
    assert_eq!((end, sum(&report, "dropped")), (End::Complete, 0));
    assert_eq!(entries.len() as u64, sum(&report, "messages"));
    assert_eq!(ticks(&entries, "state"), (0..=8000).collect::<Vec<_>>());
    let verified = rig.ok("replay --verify");
    verified.says("8001 ticks").says("identical");
    rig.ok("export").says("    8001 messages  ");
    let export = |flight: &str| {
        rig.run("export", format!("{flight} --topic state"))
            .expect(1)
    };
    // One file alone is whole, and not the whole flight; another file in its place is not taken for it.
    let second = latest(&rig, "flight.1.mcap");
    let alone = rig.run("replay", [second.to_str().unwrap()]).expect(1);
    alone.complains("it is not the log's first file; missing before it: 1");
    fs::rename(latest(&rig, "flight.2.mcap"), &second).unwrap();
    export("latest").complains(
        "flight.1.mcap is damaged or no flight log: it is file 2 of a log, and stands after file 0",
    );
    rig.ok(&fly);
    let [first, other] = &rig.run_directories()[..] else {
        panic!("two flights were flown")
    };
    let second = rig.out().join(first).join("flight.1.mcap");
    fs::copy(rig.out().join(other).join("flight.1.mcap"), &second).unwrap();
    export(first).complains(
        "flight.1.mcap is damaged or no flight log: it is of another flight than the file before it",
    );
    fs::remove_file(&second).unwrap();
    let missing = "flight.1.mcap: No such file";
    rig.run("replay", format!("{first} --verify"))
        .expect(1)
        .complains(missing)
        .complains("flight.mcap goes on in it");
    let exported = export(first).complains(missing).stdout;
    assert!(
        exported.lines().count() > 1000,
        "the first file is exported"
    );
    assert!(
        Command::new("mkfifo")
            .arg(&second)
            .status()
            .unwrap()
            .success()
    );
    export(first).complains("flight.1.mcap: it is not a regular file");
    rig.run("export", format!("{first} --format perfetto"))
        .expect(1)
        .complains("it is not a regular file")
        .says(" slices, ");
}

#[test]
fn the_newest_files_of_a_log_are_kept_where_no_more_are_to_be() {
    let rig = Rig::new("newest");
    let config = rig.settings("[recorder]\nlog_file_mb = 1\nlog_files = 2\n");
    let flown = rig.ok(&format!(
        "fly --pace lockstep --duration 8s --config {config}"
    ));
    // A file that was removed as asked is not missing.
    assert_eq!(flown.result()["status"], "PASS");
    let names = log_files(&rig);
    assert!(names.len() == 2 && names[0] != "flight.mcap", "{names:?}");
    let report = rig.report();
    let removed = sum(&report, "removed");
    assert_eq!(sum(&report, "messages") + removed, 5 * 8001 + 1);
    let text = read_file(&rig, "report.txt");
    let older = format!("; {removed} in older files, removed as asked\n");
    assert!(text.contains(&older), "{text}");
    let exported = rig.ok("export --topic state");
    let rows = exported
        .complains("is not the first file of the log")
        .stdout;
    let states = count(&report, "/recorder/log/messages/state");
    assert_eq!(rows.lines().count() as u64, 1 + states);
    rig.run("replay", "")
        .expect(1)
        .complains("cannot be replayed: it is not the log's first file")
        .complains("recorder.log_files = 0");
}

#[test]
fn intervals_of_the_latency_log_are_as_long_as_asked() {
    let rig = Rig::new("intervals");
    let config = rig.airborne("[recorder]\nhlog_every_s = 1\nlog = \"off\"\n");
    rig.ok(&format!("fly --rt off --duration 2500ms --config {config}"));
    let log = read_file(&rig, "latency.hlog");
    let head = "#[ironbird: values in nanoseconds, a tag per series, intervals of 1 s]\n";
    assert!(log.starts_with(head), "{log}");
    let lines = log
        .lines()
        .filter_map(|line| line.strip_prefix("Tag=loop,"));
    let begins: Vec<&str> = lines.map(|line| &line[..12]).collect();
    assert_eq!(begins, ["0.000,1.000,", "1.000,1.000,", "2.000,1.000,"]);
}

#[test]
fn a_flight_may_be_as_long_as_a_soak_of_a_week() {
    Rig::new("week")
        .ok("fly --duration 7d --log around-misses --print-config")
        .says("duration_s = 604800.0 ")
        .says("log = \"around-misses\" ");
}
