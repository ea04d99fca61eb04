//! The flight log: what it holds and keeps, in which files, and what exports and other readers make of it.

use crate::rig::{Ended, Rig, lacks_tool, not_tested, read_log, send, stop_for, wait_until};
use flight_log::TOPICS;
use flight_log::entry::{Counts, LogEntry};
use flight_log::facts::{Facts, LogPlan, record};
use flight_log::reader::{End, LogReader};
use flight_log::telemetry::TELEMETRY_TOPICS;
use flight_log::writer::FlightLog;
use messages::content::{State, Wrench};
use messages::grid::Pace;
use messages::header::Message;
use messages::role::Role;
use messages::telemetry::Signals;
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

fn log_of(rig: &Rig) -> PathBuf {
    rig.out().join("latest/flight.mcap")
}

/// A Python that reads logs; `None` where there is none.
fn python() -> Option<String> {
    let named = std::env::var("IRONBIRD_PYTHON")
        .ok()
        .filter(|python| !python.is_empty());
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let imports = [
        "-c",
        "import matplotlib, mcap.reader, mcap_protobuf.decoder, perfetto.protos",
    ];
    if Command::new(&python)
        .args(imports)
        .output()
        .is_ok_and(|output| output.status.success())
    {
        return Some(python);
    }
    let missing =
        format!("{python} lacks packages: pip install -r bench/rig/tests/requirements.txt");
    assert!(named.is_none(), "IRONBIRD_PYTHON: {missing}");
    lacks_tool(&format!(
        "flight.mcap is not read by another implementation: {missing}"
    ));
    None
}

/// Runs a script of the repository, and gives what it prints.
fn run_python(python: &str, script: &str, arguments: &[&Path]) -> Vec<u8> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(script);
    let output = Command::new(python)
        .arg(script)
        .args(arguments)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    output.stdout
}

/// Messages per topic, as this reader reads them.
fn counts(log: &Path) -> (Counts, End) {
    let mut reader = LogReader::open(log).unwrap();
    let mut counts = [0; TOPICS.len()];
    while let Some(entry) = reader.next_entry().unwrap() {
        counts[entry.topic()] += 1;
    }
    (counts, reader.end())
}

#[test]
fn every_message_is_in_the_log_and_others_read_the_same_numbers() {
    let rig = Rig::new("log");
    let swaps = [
        "gyro_noise_rad_s=0.01@tick100",
        "mass_kg=0.6,rotational_drag_nm_s=0.5@tick1500",
    ];
    let options = format!(
        "--pace lockstep --duration 1500ms --fault {} --fault {}",
        swaps[0], swaps[1]
    );
    rig.run("fly", &options).expect(0);
    let (log, report) = (log_of(&rig), rig.report());
    let (counts, end) = counts(&log);
    // The mixer has a last word, and the second swap holds from the last tick on.
    assert_eq!(
        (counts, end),
        ([1501, 1501, 1501, 1502, 2, 1501], End::Complete)
    );
    let section = &report["recorder"]["log"];
    for (topic, count) in TOPICS.iter().zip(counts) {
        assert_eq!(
            (&section["messages"][topic], &section["dropped"][topic]),
            (&count.into(), &0.into()),
            "{topic}"
        );
    }
    assert_eq!(section["file_bytes"], fs::metadata(&log).unwrap().len());
    assert!(section["refused"].is_null(), "{section}");
    let exported = rig.path("exported");
    let to = exported.to_str().unwrap();
    rig.ok(&format!("export --format json --to {to}"))
        .says("1502 messages")
        .says("rotor_speeds.jsonl");
    let Some(python) = python() else { return };
    let picture = rig.path("flight.png");
    run_python(&python, "docs/plot_flight.py", &[&log, &picture]);
    assert!(fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
    let read = run_python(&python, "bench/rig/tests/read_mcap.py", &[&log, &exported]);
    let read: Value = serde_json::from_slice(&read).unwrap();
    let channels = &read["channels"];
    for (topic, count) in TOPICS.iter().zip(counts) {
        assert_eq!(channels[topic]["messages"], count, "{topic}");
    }
    check_channels(channels);
    for (topic, stage) in TELEMETRY_TOPICS
        .iter()
        .zip(["setpoint", "wrench", "rotor_speeds"])
    {
        assert_eq!(
            channels[topic]["messages"], channels[stage]["messages"],
            "{topic}"
        );
        assert_eq!(channels[stage]["metadata"]["telemetry"], **topic, "{stage}");
        assert!(
            !read["first"][stage].as_str().unwrap().contains("telemetry"),
            "{}",
            read["first"][stage]
        );
    }
    assert!(
        read["first"]["pose/actual"]
            .as_str()
            .unwrap()
            .contains("frame_id: \"world\""),
        "{}",
        read["first"]
    );
    let records = &read["records"];
    let settings = fs::read_to_string(rig.out().join("latest/settings.toml")).unwrap();
    assert_eq!(records["settings"]["settings.toml"], settings);
    assert!(
        records["settings"]["shared"]
            .as_str()
            .unwrap()
            .contains("inner.alpha_1_s = 200.0\n")
    );
    assert_eq!(records["run"]["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(records["host"]["kernel"], report["host"]["kernel"]);
    assert!(
        records["realtime"]["plant"].is_string(),
        "{}",
        records["realtime"]
    );
    assert_eq!(records["landing"]["ending"], "completed");
}

fn check_channels(channels: &Value) {
    assert_eq!(channels["state"]["schema"], "ironbird.State");
    assert_eq!(
        channels["state"]["metadata"]["unit.measured.velocity_w_m_s"],
        "m/s"
    );
    assert_eq!(
        channels["state"]["metadata"]["frame.measured.velocity_w_m_s"],
        "world: right-handed, z up"
    );
    assert_eq!(
        channels["inner_telemetry"]["schema"],
        "ironbird.InnerTelemetry"
    );
    assert_eq!(
        channels["inner_telemetry"]["metadata"]["unit.rotational_drag_nm_s"],
        "N m s"
    );
    assert_eq!(
        channels["mixer_telemetry"]["metadata"]["unit.yaw_share"],
        "1"
    );
    let scene = [
        ("pose/actual", "PoseInFrame"),
        ("pose/reference", "PoseInFrame"),
        ("transforms", "FrameTransform"),
    ];
    for (topic, schema) in scene {
        assert_eq!(channels[topic]["schema"], format!("foxglove.{schema}"));
        assert!(
            channels[topic]["messages"].as_u64().unwrap() >= 38,
            "{topic}: {}",
            channels[topic]["messages"]
        );
    }
}

#[test]
fn a_trace_shows_every_tick_of_every_stage_every_miss_and_every_swap() {
    let rig = Rig::new("trace");
    let config = rig.airborne("");
    let flight = rig.take_off(format!(
        "--rt off --duration 3s --fault rotational_drag_nm_s=0.2@tick200 --config {config}"
    ));
    // Deadlines are missed on purpose, and in flight.
    rig.await_tick(0);
    stop_for(flight.roles()["mixer"], Duration::from_millis(50));
    flight.end().expect(0);
    rig.ok("export --format perfetto")
        .says("latest/flight.perfetto-trace");
    rig.refused("export --format perfetto --topic state")
        .complains("not one topic");
    let Some(python) = python() else { return };
    let trace = rig.out().join("latest/flight.perfetto-trace");
    let read: Value = serde_json::from_slice(&run_python(
        &python,
        "bench/rig/tests/read_perfetto.py",
        &[&trace],
    ))
    .unwrap();
    let tracks = [
        "ironbird",
        "plant",
        "outer",
        "inner",
        "mixer",
        "deadlines missed",
        "swaps",
    ];
    assert_eq!(read["tracks"], Value::from(tracks.to_vec()));
    let (mut reader, mut slices) = (
        LogReader::open(&log_of(&rig)).unwrap(),
        BTreeMap::<&str, Vec<Value>>::new(),
    );
    let (mut swapped_ns, mut counted, mut before) = (0, 0, None);
    while let Some(entry) = reader.next_entry().unwrap() {
        let (role, envelope) = match entry {
            LogEntry::State(message) => {
                counted = message.content.deadlines_missed;
                before.get_or_insert(if message.envelope.tick == 0 {
                    0
                } else {
                    counted
                });
                if message.content.parameter_epoch == 1 && swapped_ns == 0 {
                    swapped_ns = message.envelope.stamps_of(Role::Plant).receive_ns;
                }
                (Role::Plant, message.envelope)
            }
            LogEntry::Setpoint(message) => (Role::Outer, message.envelope),
            LogEntry::Wrench(message) => (Role::Inner, message.envelope),
            LogEntry::RotorSpeeds(message) => (Role::Mixer, message.envelope),
            LogEntry::Swap(_) | LogEntry::Theorem(_) => continue,
        };
        let stamps = envelope.stamps_of(role);
        if stamps.receive_ns > 0 {
            let stale =
                role != Role::Plant && envelope.input_tick[role as usize - 1] != envelope.tick;
            let name = if stale {
                format!("{role} (stale input)")
            } else {
                role.to_string()
            };
            let slice = serde_json::json!([envelope.tick, stamps.receive_ns, stamps.send_ns, name]);
            slices.entry(role.name()).or_default().push(slice);
        }
    }
    for (role, slices) in slices {
        assert!(slices.len() > 2000, "{role}: {}", slices.len());
        assert_eq!(read["slices"][role], Value::from(slices), "{role}");
    }
    let instants = read["instants"].as_array().unwrap();
    let of = |track: &str| {
        instants
            .iter()
            .filter(|instant| instant[0] == track)
            .collect::<Vec<_>>()
    };
    let missed: u64 = of("deadlines missed")
        .iter()
        .map(|instant| instant[2]["count"].as_u64().unwrap())
        .sum();
    // What is missed after the last state is in no state.
    let reported = rig.report()["deadlines"]["missed"].as_u64().unwrap();
    assert!(
        missed > 20 && missed == counted - before.unwrap(),
        "{missed}: {before:?} to {counted}"
    );
    assert!(counted <= reported, "{counted} of {reported}");
    let [swap] = of("swaps")[..] else {
        panic!("{instants:?}")
    };
    assert_eq!(
        (&swap[1], &swap[2]["rotational_drag_nm_s"]),
        (&swapped_ns.into(), &"0.105 -> 0.2".into())
    );
}

#[test]
fn a_law_that_shows_nothing_has_no_topic_and_an_export_of_it_says_so() {
    let rig = Rig::new("silent");
    let path = PathBuf::from(rig.file("silent.mcap"));
    let (pace, plan, signals) = (Pace::Lockstep, LogPlan::WHOLE, Signals::default());
    let records = Vec::new();
    let facts = Facts {
        pace,
        sample_time_ns: 1_000_000,
        plan,
        signals,
        no_theorem: None,
        records,
    };
    let mut log = FlightLog::create(&path, &facts).unwrap();
    let mut wrench = Message::<Wrench>::default();
    wrench.content.thrust_n = 5.0;
    log.take(LogEntry::Wrench(wrench));
    log.finish(record(&[])).unwrap();
    let mut reader = LogReader::open(&path).unwrap();
    assert_eq!(
        reader.next_entry().unwrap(),
        Some(&LogEntry::Wrench(wrench))
    );
    let path = path.to_str().unwrap();
    let refused = rig.refused(&format!("export {path} --topic inner_telemetry"));
    refused.complains(
        "silent.mcap has no topic inner_telemetry: the inner law of this flight publishes no signals",
    );
    let exported = rig
        .ok(&format!("export {path} --to {}", rig.file("tables")))
        .says("1 messages");
    assert!(
        exported.stdout.contains("wrench.csv") && !exported.stdout.contains("telemetry"),
        "{exported}"
    );
}

#[test]
fn an_export_is_whole_and_says_what_is_there_and_what_is_not() {
    let rig = Rig::new("export");
    rig.ok("fly --pace lockstep --duration 200ms --fault mass_kg=0.6@tick50");
    rig.ok("export")
        .says("     201 messages")
        .says("latest/export/state.csv");
    let csv = fs::read_to_string(rig.out().join("latest/export/state.csv")).unwrap();
    let (header, rows) = csv.split_once('\n').unwrap();
    let columns: Vec<&str> = header.split(',').collect();
    assert!(
        rows.lines().count() == 201
            && rows
                .lines()
                .all(|row| row.split(',').count() == columns.len())
    );
    let z = columns
        .iter()
        .position(|column| *column == "measured.position_w_m[2]")
        .unwrap();
    let states = fs::read_to_string(rig.out().join("latest/states.csv")).unwrap();
    let z_of = |text: &str, column: usize| {
        text.split(',')
            .nth(column)
            .unwrap()
            .parse::<f64>()
            .unwrap()
            .to_bits()
    };
    assert_eq!(
        z_of(rows.lines().nth(150).unwrap(), z),
        z_of(states.lines().nth(4).unwrap(), 3),
        "tick 150"
    );
    let swaps = rig.ok("export --topic swaps --format json").json();
    assert_eq!(
        (&swaps["envelope"]["tick"], &swaps["new"][0]),
        (&50.into(), &0.6.into())
    );
    rig.refused("export --topic wrenches")
        .complains("rotor_speeds")
        .complains("wrench");
    rig.refused("export nowhere")
        .complains("no flight at nowhere")
        .complains(&rig.run_directories()[0]);
    fs::remove_file(log_of(&rig)).unwrap();
    rig.refused("export")
        .complains("holds no flight.mcap; it holds: export")
        .complains("report.json");
    rig.refused("replay --verify")
        .complains("holds no flight.mcap");
    let random = rig.file("random.mcap");
    fs::write(&random, "no log\n").unwrap();
    for command in ["export", "replay"] {
        rig.run(command, &random)
            .expect(1)
            .complains("random.mcap is damaged or no flight log");
    }
}

#[test]
fn an_export_names_its_columns_where_nothing_was_said_and_ends_quietly_when_nobody_reads_on() {
    let rig = Rig::new("header");
    rig.ok("fly --pace lockstep --duration 3s");
    rig.ok("export").says("       0 messages");
    let swaps = fs::read_to_string(rig.out().join("latest/export/swaps.csv")).unwrap();
    assert_eq!(swaps.lines().count(), 1, "{swaps}");
    assert!(
        swaps.starts_with("envelope.layout,") && swaps.contains("parameter_epoch"),
        "{swaps}"
    );
    assert_eq!(rig.ok("export --topic swaps").stdout, swaps);
    assert_eq!(rig.ok("export --topic swaps --format json").stdout, "");
    let script = "\"$@\" | head -1; exit ${PIPESTATUS[0]}";
    let export = rig.command("export", "--topic rotor_speeds");
    let mut piped = Command::new("bash");
    piped
        .args(["-c", script, "bash"])
        .arg(export.get_program())
        .args(export.get_args());
    let ended = rig.launch(piped).end().expect(0);
    assert_eq!(
        (ended.stdout.lines().count(), ended.stderr.as_str()),
        (1, ""),
        "{ended}"
    );
}

#[test]
fn a_killed_recorder_leaves_what_it_had_written() {
    let rig = Rig::new("killed-log");
    let flight = rig.take_off(format!("--rt off --config {} --duration 1h", rig.slow(5)));
    let recorder = flight.roles()["record"];
    let log = log_of(&rig);
    wait_until("some chunks", || {
        (fs::metadata(&log).ok()?.len() > 400_000).then_some(())
    });
    send(recorder, Signal::KILL);
    flight.end().expect(1);
    let (counts, end) = counts(&log);
    assert!(end == End::Truncated && counts[0] > 100, "{counts:?}");
    let exported = rig.ok("export --topic state").complains("is truncated");
    assert_eq!(exported.stdout.lines().count() as u64, counts[0] + 1);
    rig.run("replay", "--verify")
        .expect(1)
        .complains("is truncated")
        .complains("ticks agree in");
    let replayed = rig
        .run("replay", "")
        .expect(1)
        .says("ticks replayed")
        .complains("is truncated");
    let replayed = replayed
        .complains("ticks agree in")
        .complains("only a complete log can be verified");
    assert!(
        !replayed.stdout.contains("agrees with the record"),
        "no verdict on what is not whole: {replayed}"
    );
}

/// A flight whose directory lies on a disk of `size`, in a mount namespace of its own; what is there of it is kept.
fn fly_on_a_small_disk(rig: &Rig, size: &str, args: &[&str]) -> Option<Ended> {
    let allowed = Command::new("unshare")
        .args(["-m", "mount", "-t", "tmpfs", "none", "/mnt"])
        .output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        not_tested("a full disk: this needs a mount namespace (root)");
        return None;
    }
    let (disk, kept) = (rig.path("disk"), rig.path("kept"));
    fs::create_dir(&disk).unwrap();
    let script = "mount -t tmpfs -o size=$1 none $2; shift; at=$1; kept=$2; shift 2; \"$@\"; code=$?; \
        cp -rL $at/latest $kept; exit $code";
    let flight = rig.command("fly", [args, &["--out", disk.to_str().unwrap()]].concat());
    let mut command = Command::new("unshare");
    command
        .args(["-m", "sh", "-c", script, "sh", size])
        .arg(&disk)
        .arg(&kept);
    command
        .arg(flight.get_program())
        .args(flight.get_args())
        .env("IRONBIRD_ROOT", rig.root())
        .process_group(0);
    Some(rig.launch(command).end())
}

/// A flight in lockstep on such a disk, with its report.
fn flown_on_a_small_disk(rig: &Rig, size: &str) -> Option<(Ended, Value)> {
    let ended = fly_on_a_small_disk(rig, size, &["--pace", "lockstep", "--duration", "12s"])?;
    let report =
        fs::read_to_string(rig.path("kept/report.json")).unwrap_or_else(|e| panic!("{e}: {ended}"));
    Some((ended, serde_json::from_str(&report).unwrap()))
}

#[test]
#[ignore = "long: part of the gate"]
fn a_full_disk_costs_messages_and_not_the_flight() {
    let rig = Rig::new("full");
    let Some((ended, report)) = flown_on_a_small_disk(&rig, "7m") else {
        return;
    };
    let ended = ended
        .expect(0)
        .tells("less than 4 MiB would be left free on the disk");
    let (result, text) = (ended.result(), ended.stdout);
    assert_eq!(
        (result["status"].as_str(), result["ticks"].as_str()),
        ("INCOMPLETE", "12001")
    );
    let unlogged: u64 = result["unlogged"].parse().unwrap();
    assert!(unlogged > 1000 && result["lost"] == "0", "{result:?}");
    assert!(
        text.lines()
            .take(9)
            .any(|line| line
                .starts_with(&format!("INCOMPLETE RECORD: flight.mcap lacks {unlogged} "))),
        "{text}"
    );
    let section = &report["recorder"]["log"];
    let of = |what: &str, topic: &str| section[what][topic].as_u64().unwrap();
    assert!(
        of("dropped", "state") > 1000 && of("messages", "state") > 1000,
        "{section}"
    );
    for topic in ["state", "setpoint", "wrench"] {
        assert_eq!(
            of("dropped", topic) + of("messages", topic),
            12_001,
            "{topic}"
        );
    }
    let log = rig.path("kept/flight.mcap");
    let (counts, end) = counts(&log);
    assert_eq!(end, End::Truncated);
    assert_eq!(
        (counts[0], counts[3]),
        (of("messages", "state"), of("messages", "rotor_speeds"))
    );
    assert_eq!(section["file_bytes"], fs::metadata(&log).unwrap().len());
    assert_eq!(report["recorder"]["unwritten"], serde_json::json!({}));
}

#[test]
#[ignore = "long: part of the gate"]
fn a_disk_without_room_for_any_message_is_named_in_the_result() {
    let rig = Rig::new("no-room");
    let Some((ended, report)) = flown_on_a_small_disk(&rig, "3m") else {
        return;
    };
    // The flight was flown, and its gates judged as it flew.
    let result = ended.expect(0).result();
    assert_eq!(result["status"], "INCOMPLETE");
    assert_eq!(report["verdict"]["status"], "INCOMPLETE");
    assert!(result["unlogged"].parse::<u64>().unwrap() > 0, "{result:?}");
    assert_eq!(report["recorder"]["log"]["messages"]["state"], 0);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_disk_without_room_for_the_report_does_not_make_up_a_log() {
    for size in ["100k", "200k"] {
        let rig = Rig::new("no-report");
        let Some(ended) = fly_on_a_small_disk(&rig, size, &["--rt", "off", "--duration", "3s"])
        else {
            return;
        };
        let ended = ended.expect(1).says("ABORTED").says("the recorder died");
        let processes = rig.ok(&format!("report {} --section processes", rig.file("kept")));
        processes.says(" 0 messages in 0.0 MB, ");
        assert!(
            ended.result()["unlogged"].parse::<u64>().unwrap() > 0,
            "{size}: {ended}"
        );
        assert!(
            ended
                .stdout
                .lines()
                .any(|line| line.starts_with("INCOMPLETE RECORD: flight.mcap lacks ")),
            "{size}: {ended}"
        );
        assert_eq!(
            fs::metadata(rig.path("kept/flight.mcap")).unwrap().len(),
            0,
            "{size}"
        );
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_disk_without_room_for_what_a_role_says_is_no_panic() {
    for size in ["4k", "8k", "12k", "16k", "20k", "24k", "32k"] {
        let rig = Rig::new("speechless");
        let Some(ended) = fly_on_a_small_disk(&rig, size, &["--rt", "off", "--duration", "300ms"])
        else {
            return;
        };
        assert!(matches!(ended.code, Some(1 | 2)), "{size}: {ended}");
        let why = [
            "No space left on device",
            "the disk is full, and had no room",
        ];
        assert!(
            why.iter().any(|why| ended.stderr.contains(why)),
            "{size}: {ended}"
        );
        assert!(
            !ended.stderr.contains("has what was recorded"),
            "{size}: {ended}"
        );
        assert!(
            !ended.stderr.contains("status: 101") && !ended.stdout.contains("status: 101"),
            "{size}: {ended}"
        );
        rig.assert_nothing_left();
    }
}

fn ticks(entries: &[LogEntry], topic: usize) -> Vec<u64> {
    entries
        .iter()
        .filter(|entry| entry.topic() == topic)
        .map(|entry| entry.envelope().tick)
        .collect()
}

fn states(entries: &[LogEntry]) -> Vec<Message<State>> {
    let state = |entry: &LogEntry| match entry {
        LogEntry::State(message) => Some(*message),
        _ => None,
    };
    entries.iter().filter_map(state).collect()
}

fn sum(log: &Value, what: &str) -> u64 {
    TOPICS
        .iter()
        .map(|topic| log[what][topic].as_u64().unwrap())
        .sum()
}

fn file_names(directory: &Path) -> Vec<String> {
    let names = fs::read_dir(directory)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name.ends_with(".mcap")).collect();
    names.sort();
    names
}

#[test]
fn an_excerpt_holds_take_off_swaps_and_landing_and_says_that_it_is_one() {
    let rig = Rig::new("excerpt");
    let config = rig.settings("[recorder]\nlog_around_s = 0.05\n");
    let flight =
        format!("--pace lockstep --duration 1s --fault mass_kg=0.6@tick500 --config {config}");
    rig.ok(&format!("fly {flight} --log around-misses"));
    let (entries, end) = read_log(&rig.out().join("latest/flight.mcap"));
    assert_eq!(end, End::Complete);
    let expected: Vec<u64> = (0..=50).chain(450..=550).chain(950..=1000).collect();
    for topic in [0, 1, 2, 5] {
        assert_eq!(ticks(&entries, topic), expected, "{}", TOPICS[topic]);
    }
    assert_eq!(ticks(&entries, 4), [500], "the swap");
    let report = rig.report();
    let log = &report["recorder"]["log"];
    assert_eq!(
        (&log["kept"], &log["stretches"], &log["files"]),
        (&"around-misses".into(), &3.into(), &1.into())
    );
    assert_eq!(
        (sum(log, "left_out"), sum(log, "dropped")),
        (5 * (1001 - 203), 0),
        "{log}"
    );
    // What was not to be kept is not missing.
    assert_eq!(
        (&report["verdict"]["status"], sum(log, "messages")),
        (&"PASS".into(), entries.len() as u64)
    );
    let text = fs::read_to_string(rig.out().join("latest/report.txt")).unwrap();
    assert!(
        text.contains("; 3 excerpts kept, 3990 left out as asked\n"),
        "{text}"
    );
    let exported = rig
        .ok("export --topic state")
        .complains("contains excerpts: 50 ticks before");
    assert_eq!(exported.stdout.lines().count(), 1 + expected.len());
    for verify in [&["--verify"][..], &[]] {
        let refused = rig
            .run("replay", verify)
            .expect(1)
            .complains("cannot be replayed: it keeps excerpts, 50 ticks");
        assert_eq!(refused.complains("fly --log all").stdout, "");
    }
}

/// The ticks that were skipped before a state; those right before it, where others were left out of the log as well.
fn skipped_between(before: &Message<State>, after: &Message<State>) -> Range<u64> {
    after.envelope.tick - (after.content.ticks_skipped - before.content.ticks_skipped)
        ..after.envelope.tick
}

#[test]
fn an_excerpt_holds_what_is_around_every_missed_deadline() {
    const AROUND: u64 = 20;
    let rig = Rig::new("around");
    let config = rig.settings(
        "[flight]\nslowdown = 5\n[recorder]\nlog = \"around-misses\"\nlog_around_s = 0.02\n",
    );
    let flight = rig.take_off(format!("--rt off --duration 1s --config {config}"));
    rig.await_tick(200);
    stop_for(flight.roles()["mixer"], Duration::from_millis(60));
    flight.end().expect(0);
    let report = rig.report();
    let missed = report["deadlines"]["missed"].as_u64().unwrap();
    let (entries, end) = read_log(&rig.out().join("latest/flight.mcap"));
    let states = states(&entries);
    assert!(missed > 5 && end == End::Complete, "{missed} missed");
    // What is missed after the last state is in no state.
    assert!(
        (missed - 1..=missed).contains(&states.last().unwrap().content.deadlines_missed),
        "of {missed}"
    );
    // A plant that begins late skips ticks before its first state, too.
    let before_first = 0..states[0].content.ticks_skipped;
    let skipped: Vec<u64> = states
        .windows(2)
        .flat_map(|pair| skipped_between(&pair[0], &pair[1]))
        .chain(before_first)
        .collect();
    let last_tick = states.last().unwrap().envelope.tick;
    let mut gaps = 0;
    for pair in states.windows(2) {
        let (before, after) = (&pair[0], &pair[1]);
        let is_gap = before.envelope.tick + 1 != skipped_between(before, after).start;
        gaps += u64::from(is_gap);
        if after.content.deadlines_missed > before.content.deadlines_missed {
            assert!(
                !is_gap,
                "a deadline was missed between ticks {} and {}",
                before.envelope.tick, after.envelope.tick
            );
            let tick = after.envelope.tick;
            let near = |of: &u64| of.abs_diff(tick) <= AROUND;
            let around = states
                .iter()
                .filter(|state| near(&state.envelope.tick))
                .count() as u64;
            let skipped = skipped.iter().filter(|of| near(of)).count() as u64;
            let whole = (tick + AROUND).min(last_tick) - tick.saturating_sub(AROUND) + 1;
            assert!(
                around + skipped >= whole,
                "around tick {tick}: {around} of {whole}, {skipped} skipped"
            );
        }
    }
    assert!(
        gaps > 0 && sum(&report["recorder"]["log"], "left_out") > 0,
        "everything is kept: {}",
        report["recorder"]
    );
    assert_eq!(report["verdict"]["status"], "PASS");
}

#[test]
fn a_flight_without_a_log_has_a_report_and_says_why_there_is_no_more() {
    let rig = Rig::new("no-log");
    let flown = rig.ok("fly --pace lockstep --duration 1s --log off");
    let result = flown.result();
    assert_eq!(
        (
            result["status"].as_str(),
            result["unlogged"].as_str(),
            result["ticks"].as_str()
        ),
        ("PASS", "0", "1001")
    );
    assert_eq!(file_names(&rig.out().join("latest")), Vec::<String>::new());
    let text = fs::read_to_string(rig.out().join("latest/report.txt")).unwrap();
    assert!(
        text.contains("flight.mcap: none, as asked (recorder.log = off)\n"),
        "{text}"
    );
    assert!(
        fs::metadata(rig.out().join("latest/latency.hlog"))
            .unwrap()
            .len()
            > 0
    );
    for command in ["export", "replay"] {
        let refused = rig
            .run(command, "")
            .expect(2)
            .complains("holds no flight.mcap: it was flown with recorder.log");
        refused.complains("`fly --log all` logs every message");
    }
}

#[test]
fn a_long_log_goes_on_in_further_files_and_is_read_as_one() {
    let rig = Rig::new("files");
    let config = rig.settings("[recorder]\nlog_file_mb = 2\n");
    rig.ok(&format!(
        "fly --pace lockstep --duration 8s --config {config}"
    ));
    let latest = rig.out().join("latest");
    let report = rig.report();
    let log = &report["recorder"]["log"];
    let names = file_names(&latest);
    assert!(
        names.len() > 2 && log["files"] == names.len(),
        "{names:?} {log}"
    );
    let bytes: u64 = names
        .iter()
        .map(|name| fs::metadata(latest.join(name)).unwrap().len())
        .sum();
    assert_eq!(
        (&log["file_bytes"], sum(log, "dropped")),
        (&bytes.into(), 0)
    );
    let (entries, end) = read_log(&latest.join("flight.mcap"));
    assert_eq!(
        (end, entries.len() as u64),
        (End::Complete, sum(log, "messages"))
    );
    assert_eq!(ticks(&entries, 0), (0..=8000).collect::<Vec<_>>());
    rig.ok("replay --verify")
        .says("8001 ticks")
        .says("identical");
    rig.ok("export").says("    8001 messages  ");
    // One of them alone is whole, and no whole flight.
    let second = latest.join("flight.1.mcap");
    rig.run("replay", second.to_str().unwrap())
        .expect(1)
        .complains("it is not the log's first file; missing before it: 1");
    let export = || rig.run("export", "--topic state").expect(1);
    // What only looks like it is not taken for it.
    fs::rename(latest.join("flight.2.mcap"), &second).unwrap();
    export()
        .complains("latest/flight.1.mcap is damaged or no flight log: it is file 2 of a log, and stands after file 0");
    rig.ok(&format!(
        "fly --pace lockstep --duration 8s --config {config}"
    ));
    let [.., first, other] = &rig.run_directories()[..] else {
        panic!("two flights were flown")
    };
    let second = rig.out().join(first).join("flight.1.mcap");
    fs::copy(rig.out().join(other).join("flight.1.mcap"), &second).unwrap();
    let of_first = || {
        rig.run("export", format!("{first} --topic state"))
            .expect(1)
    };
    of_first().complains("flight.1.mcap is damaged or no flight log: it is of another flight than the file before it");
    fs::remove_file(&second).unwrap();
    let missing = "flight.1.mcap: No such file";
    rig.run("replay", format!("{first} --verify"))
        .expect(1)
        .complains(missing)
        .complains("flight.mcap goes on in it");
    let exported = of_first().complains(missing);
    assert!(
        exported.stdout.lines().count() > 1000,
        "what stands before is exported"
    );
    assert!(
        Command::new("mkfifo")
            .arg(&second)
            .status()
            .unwrap()
            .success()
    );
    of_first().complains("flight.1.mcap: it is not a regular file");
    let trace = rig
        .run("export", format!("{first} --format perfetto"))
        .expect(1)
        .complains("it is not a regular file");
    trace.says(" slices, ");
}

#[test]
fn the_newest_files_of_a_log_are_kept_where_no_more_are_to_be() {
    let rig = Rig::new("newest");
    let config = rig.settings("[recorder]\nlog_file_mb = 1\nlog_files = 2\n");
    let flown = rig.ok(&format!(
        "fly --pace lockstep --duration 8s --config {config}"
    ));
    assert_eq!(
        flown.result()["status"],
        "PASS",
        "what was removed as asked is not missing"
    );
    let latest = rig.out().join("latest");
    let names = file_names(&latest);
    assert!(
        names.len() == 2 && !names.contains(&"flight.mcap".to_owned()),
        "{names:?}"
    );
    let report = rig.report();
    let log = &report["recorder"]["log"];
    assert_eq!(
        sum(log, "messages") + sum(log, "removed"),
        5 * 8001 + 1,
        "{log}"
    );
    let text = fs::read_to_string(latest.join("report.txt")).unwrap();
    assert!(
        text.contains(&format!(
            "; {} in older files, removed as asked\n",
            sum(log, "removed")
        )),
        "{text}"
    );
    let exported = rig
        .ok("export --topic state")
        .complains("is not the first file of the log");
    assert_eq!(
        exported.stdout.lines().count() as u64,
        1 + log["messages"]["state"].as_u64().unwrap()
    );
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
    let log = fs::read_to_string(rig.out().join("latest/latency.hlog")).unwrap();
    assert!(
        log.starts_with("#[ironbird: values in nanoseconds, a tag per series, intervals of 1 s]\n"),
        "{log}"
    );
    let begins: Vec<&str> = log
        .lines()
        .filter_map(|line| line.strip_prefix("Tag=loop,"))
        .collect();
    let expected = ["0.000,1.000,", "1.000,1.000,", "2.000,1.000,"];
    assert!(
        begins.len() == 3
            && begins
                .iter()
                .zip(expected)
                .all(|(line, begin)| line.starts_with(begin)),
        "{begins:?}"
    );
}

#[test]
fn a_flight_may_be_as_long_as_a_soak_of_a_week() {
    let rig = Rig::new("week");
    let printed = rig.ok("fly --duration 7d --log around-misses --print-config");
    printed
        .says("duration_s = 604800.0 ")
        .says("log = \"around-misses\" ");
}
