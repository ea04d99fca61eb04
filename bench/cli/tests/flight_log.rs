//! The flight log: what it holds and keeps, in which files, and what exports and other readers make of it.

use crate::python::{python_with, run_python};
use crate::rig::{Rig, read_log, stop_for};
use flight_log::TOPICS;
use flight_log::entry::LogEntry;
use flight_log::reader::End;
use flight_log::telemetry::TELEMETRY_TOPICS;
use messages::role::Role;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

fn latest(rig: &Rig, file: &str) -> PathBuf {
    rig.out().join("latest").join(file)
}

fn count(value: &Value, pointer: &str) -> u64 {
    let number = value.pointer(pointer).and_then(Value::as_u64);
    number.unwrap_or_else(|| panic!("no count at {pointer} of {value}"))
}

fn ticks(entries: &[LogEntry], topic: &str) -> Vec<u64> {
    let of_topic = entries
        .iter()
        .filter(|entry| TOPICS[entry.topic()] == topic);
    of_topic.map(|entry| entry.envelope().tick).collect()
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
    let read = run_python(&python, "bench/cli/tests/read_mcap.py", &[&log, &exported]);
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
        rig.flown("settings.toml")
    );
    let shared = records["settings"]["shared"].as_str().unwrap();
    assert!(shared.contains("inner.alpha_1_s = 200.0\n"), "{shared}");
    assert_eq!(records["host"]["kernel"], rig.report()["host"]["kernel"]);
    assert!(records["realtime"]["plant"].is_string(), "{records}");
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
    let read = run_python(&python, "bench/cli/tests/read_perfetto.py", &[&trace]);
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
