//! What flight.mcap keeps: everything, excerpts or nothing, in files of a length; and what can be done with each.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::ops::Range;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use crate::rig::{Rig, read_log, stop_for};
use flight_log::TOPICS;
use flight_log::entry::LogEntry;
use flight_log::reader::End;
use model::envelope::Message;
use model::messages::State;
use serde_json::Value;

fn ticks(entries: &[LogEntry], topic: usize) -> Vec<u64> {
    entries.iter().filter(|entry| entry.topic() == topic).map(|entry| entry.envelope().tick).collect()
}

fn states(entries: &[LogEntry]) -> Vec<Message<State>> {
    let state = |entry: &LogEntry| match entry {
        LogEntry::State(message) => Some(*message),
        _ => None,
    };
    entries.iter().filter_map(state).collect()
}

fn sum(log: &Value, what: &str) -> u64 {
    TOPICS.iter().map(|topic| log[what][topic].as_u64().unwrap()).sum()
}

fn file_names(directory: &Path) -> Vec<String> {
    let names = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name.ends_with(".mcap")).collect();
    names.sort();
    names
}

#[test]
fn an_excerpt_holds_take_off_swaps_and_landing_and_says_that_it_is_one() {
    let rig = Rig::new("excerpt");
    let config = rig.settings("[recorder]\nlog_around_s = 0.05\n");
    let flight = ["--pace", "lockstep", "--duration", "1s", "--fault", "mass_kg=0.6@tick500", "--config", &config];
    rig.run("fly", &[&flight[..], &["--log", "around-misses"]].concat()).expect(0);
    let (entries, end) = read_log(&rig.out().join("latest/flight.mcap"));
    assert_eq!(end, End::Complete);
    let expected: Vec<u64> = (0..=50).chain(450..=550).chain(950..=1000).collect();
    for topic in [0, 1, 2, 5] {
        assert_eq!(ticks(&entries, topic), expected, "{}", TOPICS[topic]);
    }
    assert_eq!(ticks(&entries, 4), [500], "the swap");
    let report = rig.report();
    let log = &report["recorder"]["log"];
    assert_eq!((&log["kept"], &log["stretches"], &log["files"]), (&"around-misses".into(), &3.into(), &1.into()));
    assert_eq!((sum(log, "left_out"), sum(log, "dropped")), (5 * (1001 - 203), 0), "{log}");
    // What was not to be kept is not missing.
    assert_eq!((&report["verdict"]["status"], sum(log, "messages")), (&"PASS".into(), entries.len() as u64));
    let text = fs::read_to_string(rig.out().join("latest/report.txt")).unwrap();
    assert!(text.contains("; 3 excerpts kept, 3990 left out as asked\n"), "{text}");
    let exported = rig.run("export", &["--topic", "state"]).expect(0).complains("keeps excerpts: 50 ticks before");
    assert_eq!(exported.stdout.lines().count(), 1 + expected.len());
    for verify in [&["--verify"][..], &[]] {
        let refused = rig.run("replay", verify).expect(1).complains("cannot be replayed: it keeps excerpts, 50 ticks");
        assert_eq!(refused.complains("fly --log all").stdout, "");
    }
}

/// The ticks that were skipped before a state; those right before it, where others were left out of the log as well.
fn skipped_between(before: &Message<State>, after: &Message<State>) -> Range<u64> {
    after.envelope.tick - (after.content.ticks_skipped - before.content.ticks_skipped)..after.envelope.tick
}

#[test]
fn an_excerpt_holds_what_is_around_every_missed_deadline() {
    const AROUND: u64 = 20;
    let rig = Rig::new("around");
    let config = rig.settings("[flight]\nslowdown = 5\n[recorder]\nlog = \"around-misses\"\nlog_around_s = 0.02\n");
    let flight = rig.take_off(&["--rt", "off", "--duration", "1s", "--config", &config]);
    sleep(Duration::from_secs(2));
    stop_for(flight.roles()["mixer"], Duration::from_millis(60));
    flight.end().expect(0);
    let report = rig.report();
    let missed = report["deadlines"]["missed"].as_u64().unwrap();
    let (entries, end) = read_log(&rig.out().join("latest/flight.mcap"));
    let states = states(&entries);
    assert!(missed > 5 && end == End::Complete, "{missed} missed");
    // What is missed after the last state is in no state.
    assert!((missed - 1..=missed).contains(&states.last().unwrap().content.deadlines_missed), "of {missed}");
    let skipped: Vec<u64> = states.windows(2).flat_map(|pair| skipped_between(&pair[0], &pair[1])).collect();
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
            let around = states.iter().filter(|state| near(&state.envelope.tick)).count() as u64;
            let skipped = skipped.iter().filter(|of| near(of)).count() as u64;
            let whole = (tick + AROUND).min(1000) - tick.saturating_sub(AROUND) + 1;
            assert!(around + skipped >= whole, "around tick {tick}: {around} of {whole}, {skipped} skipped");
        }
    }
    assert!(gaps > 0 && sum(&report["recorder"]["log"], "left_out") > 0, "everything is kept: {}", report["recorder"]);
    assert_eq!(report["verdict"]["status"], "PASS");
}

#[test]
fn a_flight_without_a_log_has_a_report_and_says_why_there_is_no_more() {
    let rig = Rig::new("no-log");
    let flown = rig.run("fly", &["--pace", "lockstep", "--duration", "1s", "--log", "off"]).expect(0);
    let result = flown.result();
    assert_eq!(
        (result["status"].as_str(), result["unlogged"].as_str(), result["ticks"].as_str()),
        ("PASS", "0", "1001")
    );
    assert_eq!(file_names(&rig.out().join("latest")), Vec::<String>::new());
    let text = fs::read_to_string(rig.out().join("latest/report.txt")).unwrap();
    assert!(text.contains("flight.mcap: none, as asked (recorder.log = off)\n"), "{text}");
    assert!(fs::metadata(rig.out().join("latest/latency.hlog")).unwrap().len() > 0);
    for command in ["export", "replay"] {
        let refused = rig.run(command, &[]).expect(2).complains("holds no flight.mcap: it was flown with recorder.log");
        refused.complains("`fly --log all` keeps every message");
    }
}

#[test]
fn a_long_log_goes_on_in_further_files_and_is_read_as_one() {
    let rig = Rig::new("files");
    let config = rig.settings("[recorder]\nlog_file_mb = 2\n");
    rig.run("fly", &["--pace", "lockstep", "--duration", "8s", "--config", &config]).expect(0);
    let latest = rig.out().join("latest");
    let report = rig.report();
    let log = &report["recorder"]["log"];
    let names = file_names(&latest);
    assert!(names.len() > 2 && log["files"] == names.len(), "{names:?} {log}");
    let bytes: u64 = names.iter().map(|name| fs::metadata(latest.join(name)).unwrap().len()).sum();
    assert_eq!((&log["file_bytes"], sum(log, "dropped")), (&bytes.into(), 0));
    let (entries, end) = read_log(&latest.join("flight.mcap"));
    assert_eq!((end, entries.len() as u64), (End::Complete, sum(log, "messages")));
    assert_eq!(ticks(&entries, 0), (0..=8000).collect::<Vec<_>>());
    rig.run("replay", &["--verify"]).expect(0).says("8001 ticks").says("identical");
    rig.run("export", &[]).expect(0).says("    8001 messages  ");
    // One of them alone is whole, and no whole flight.
    let second = latest.join("flight.1.mcap");
    rig.run("replay", &[second.to_str().unwrap()])
        .expect(1)
        .complains("not the log's first file; missing before it: 1");
    let export = || rig.run("export", &["--topic", "state"]).expect(1);
    // What only looks like it is not taken for it.
    fs::rename(latest.join("flight.2.mcap"), &second).unwrap();
    export()
        .complains("latest/flight.1.mcap is damaged or no flight log: it is file 2 of a log, and stands after file 0");
    rig.run("fly", &["--pace", "lockstep", "--duration", "8s", "--config", &config]).expect(0);
    let [.., first, other] = &rig.run_directories()[..] else { panic!("two flights were flown") };
    let second = rig.out().join(first).join("flight.1.mcap");
    fs::copy(rig.out().join(other).join("flight.1.mcap"), &second).unwrap();
    let of_first = || rig.run("export", &[first, "--topic", "state"]).expect(1);
    of_first().complains("flight.1.mcap is damaged or no flight log: it is of another flight than the file before it");
    fs::remove_file(&second).unwrap();
    let missing = "flight.1.mcap: No such file";
    rig.run("replay", &[first, "--verify"]).expect(1).complains(missing).complains("flight.mcap goes on in it");
    let exported = of_first().complains(missing);
    assert!(exported.stdout.lines().count() > 1000, "what stands before is exported");
    assert!(Command::new("mkfifo").arg(&second).status().unwrap().success());
    of_first().complains("flight.1.mcap: it is not a regular file");
    let trace = rig.run("export", &[first, "--format", "perfetto"]).expect(1).complains("it is not a regular file");
    trace.says(" slices, ");
}

#[test]
fn the_newest_files_of_a_log_are_kept_where_no_more_are_to_be() {
    let rig = Rig::new("newest");
    let config = rig.settings("[recorder]\nlog_file_mb = 1\nlog_files = 2\n");
    let flown = rig.run("fly", &["--pace", "lockstep", "--duration", "8s", "--config", &config]).expect(0);
    assert_eq!(flown.result()["status"], "PASS", "what was removed as asked is not missing");
    let latest = rig.out().join("latest");
    let names = file_names(&latest);
    assert!(names.len() == 2 && !names.contains(&"flight.mcap".to_owned()), "{names:?}");
    let report = rig.report();
    let log = &report["recorder"]["log"];
    assert_eq!(sum(log, "messages") + sum(log, "removed"), 5 * 8001 + 1, "{log}");
    let text = fs::read_to_string(latest.join("report.txt")).unwrap();
    assert!(text.contains(&format!("; {} in older files, removed as asked\n", sum(log, "removed"))), "{text}");
    let exported = rig.run("export", &["--topic", "state"]).expect(0).complains("is not the log's first file");
    assert_eq!(exported.stdout.lines().count() as u64, 1 + log["messages"]["state"].as_u64().unwrap());
    rig.run("replay", &[])
        .expect(1)
        .complains("cannot be replayed: it is not the log's first file")
        .complains("recorder.log_files = 0");
}

#[test]
fn intervals_of_the_latency_log_are_as_long_as_asked() {
    let rig = Rig::new("intervals");
    let config = rig.settings("[recorder]\nhlog_every_s = 2\nlog = \"off\"\n");
    rig.run("fly", &["--rt", "off", "--duration", "4500ms", "--config", &config]).expect(0);
    let log = fs::read_to_string(rig.out().join("latest/latency.hlog")).unwrap();
    assert!(log.starts_with("#[ironbird: values in nanoseconds, a tag per series, intervals of 2 s]\n"), "{log}");
    let begins: Vec<&str> = log.lines().filter_map(|line| line.strip_prefix("Tag=loop,")).collect();
    let expected = ["0.000,2.000,", "2.000,2.000,", "4.000,2.000,"];
    assert!(
        begins.len() == 3 && begins.iter().zip(expected).all(|(line, begin)| line.starts_with(begin)),
        "{begins:?}"
    );
}

#[test]
fn a_flight_may_be_as_long_as_a_soak_of_a_week() {
    let rig = Rig::new("week");
    let printed = rig.run("fly", &["--duration", "7d", "--log", "around-misses", "--print-config"]).expect(0);
    printed.says("duration_s = 604800.0 ").says("log = \"around-misses\" ");
}
