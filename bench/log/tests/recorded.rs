//! What is read of recorded flights, written again and exported is as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! flight_log` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flight_log::codec::Logged;
use flight_log::entry::{FORMATS, LogEntry, with_message};
use flight_log::facts::{Facts, LogPlan, Record};
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::LogReader;
use flight_log::rows::Cell;
use flight_log::scene::{self, Placed};
use flight_log::writer::{CHUNK_NS, FlightLog};
use flight_log::{fault_record, rows};
use messages::header::Message;
use messages::role::Channel;
use messages::telemetry::{Signals, Telemetry};

const FLIGHTS: [&str; 3] = ["real-time", "swap", "message-faults"];

fn recorded(flight: &str) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/tests/golden");
    golden.join(flight).join("flight.mcap")
}

fn entries(reader: &mut LogReader) -> Vec<LogEntry> {
    std::iter::from_fn(|| reader.next_entry().unwrap().copied()).collect()
}

fn sum(bytes: &[u8]) -> String {
    format!(
        "{} bytes, CRC-32 {:08x}\n",
        bytes.len(),
        crc32fast::hash(bytes)
    )
}

/// As the cells of a row, with what the law shows.
fn lines<C: Logged>(reader: &LogReader, message: &Message<C>) -> String {
    let cells = rows::cells(message);
    assert_eq!(cells.len(), rows::columns::<C>().len());
    let row = |cells: Vec<Cell>| {
        cells
            .iter()
            .map(Cell::to_string)
            .collect::<Vec<_>>()
            .join(",")
    };
    let mut lines = row(cells) + "\n";
    lines += &sum(format!("{:?}", rows::words(&message.content)).as_bytes());
    let signals = reader.telemetry(C::SENDER);
    if let Some((signals, telemetry)) = signals.zip(message.content.telemetry()) {
        lines += &format!("{}\n", row(signals.cells(telemetry)));
    }
    lines
}

fn perfetto(entries: &[LogEntry]) -> String {
    let mut trace = Vec::new();
    let mut writer = PerfettoWriter::new(&mut trace, Vec::new(), None).unwrap();
    entries.iter().for_each(|it| writer.take(it).unwrap());
    writer.begin_channel(Channel::ALL[1]).unwrap();
    entries.iter().for_each(|it| writer.take(it).unwrap());
    let counts = [writer.slices, writer.instants];
    writer.finish().unwrap();
    format!("Perfetto: {counts:?} slices and instants, {}", sum(&trace))
}

#[test]
fn what_is_read_and_exported_is_its_snapshot() {
    for flight in FLIGHTS {
        let mut reader = LogReader::open(&recorded(flight)).unwrap();
        let entries = entries(&mut reader);
        let mut text = format!(
            "{:?} {:?} {:?} {}\nmissing {:?}, injected {:?}\n",
            reader.end(),
            reader.pace().unwrap(),
            reader.kept().unwrap(),
            reader.build(),
            reader.missing().unwrap(),
            fault_record::injected(&recorded(flight)).unwrap(),
        );
        for (topic, format) in FORMATS.iter().enumerate() {
            let of_topic: Vec<_> = entries.iter().filter(|it| it.topic() == topic).collect();
            let lines = |it: &LogEntry| with_message!(it, message => lines(&reader, message));
            let all: String = of_topic.iter().map(|it| lines(it)).collect();
            text += &format!(
                "{} {}: {}",
                of_topic.len(),
                format.name,
                sum(all.as_bytes())
            );
            let one = of_topic.get(7).or(of_topic.first());
            text += &one.map_or(String::new(), |it| lines(it));
        }
        text += &perfetto(&entries);
        let placed = |entry: &LogEntry| match entry {
            LogEntry::State(message) => Some(Placed::airframe(7, &message.content)),
            LogEntry::Setpoint(message) => Some(Placed::reference(8, &message.content)),
            _ => None,
        };
        let scene = entries.iter().filter_map(placed);
        let scene: Vec<_> = scene.flat_map(|it| it.messages()).collect();
        text += &format!("scene: {}", sum(format!("{scene:?}").as_bytes()));
        insta::assert_snapshot!(format!("{flight}.read"), text);
    }
}

/// A line for each unit, with what has it.
fn by_unit(units: &BTreeMap<String, String>) -> String {
    let mut fields: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (field, unit) in units {
        fields.entry(unit).or_default().push(field);
    }
    let lines = fields.iter();
    lines
        .map(|(unit, fields)| format!("    {unit}: {}\n", fields.join(" ")))
        .collect()
}

#[test]
fn schemas_and_units_are_their_snapshots() {
    let of_all = FORMATS.map(|format| (format.describe)());
    let is_common = |key: &str, unit: &str| {
        let mut formats = of_all.iter();
        formats.all(|units| units.get(key).is_some_and(|it| it == unit))
    };
    let mut common = of_all[0].clone();
    common.retain(|key, unit| is_common(key, unit));
    let mut text = format!("all\n{}", by_unit(&common));
    for (format, mut units) in FORMATS.iter().zip(of_all.clone()) {
        let lacking = units.iter().filter(|(_, unit)| unit.starts_with("docs"));
        let lacking: Vec<_> = lacking.map(|(field, _)| field).collect();
        assert!(
            lacking.is_empty() || !["state", "wrench"].contains(&format.name),
            "bench/log/src/units.rs lacks the units of {lacking:?}"
        );
        units.retain(|key, unit| !is_common(key, unit));
        let columns = (format.columns)();
        let columns = columns
            .iter()
            .map(|it| format!("{} [{}]", it.name, it.unit));
        text += &format!(
            "{} {}\n{}{}\n{}",
            format.name,
            (format.schema_name)(),
            by_unit(&units),
            columns.collect::<Vec<_>>().join(","),
            sum(&(format.descriptor_set)()),
        );
    }
    text += &format!("scene: {}", sum(&scene::descriptor_set()));
    insta::assert_snapshot!("schemas", text);
}

#[test]
fn a_log_that_is_written_again_has_the_same_messages_or_an_excerpt() {
    for flight in FLIGHTS {
        let mut reader = LogReader::open(&recorded(flight)).unwrap();
        let mut all = entries(&mut reader);
        // The new log knows no signals.
        let shown = all.iter_mut().filter_map(LogEntry::telemetry_mut);
        shown.for_each(|telemetry| *telemetry = Telemetry::default());
        for (name, around_ticks) in [("whole", None), ("excerpt", Some(10))] {
            let plan = LogPlan {
                around_ticks,
                ..LogPlan::WHOLE
            };
            let facts = Facts {
                pace: reader.pace().unwrap(),
                sample_time_ns: 1_000_000,
                plan,
                signals: Signals::default(),
                no_theorem: None,
                records: Vec::new(),
            };
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("flight.mcap");
            let mut log = FlightLog::create(&path, &facts).unwrap();
            for (i, entry) in (0..).zip(&all) {
                log.take(entry, i);
                // A chunk for each hundred messages.
                log.keep(i * CHUNK_NS / 100).unwrap();
            }
            let mut fate = log.finish(Record::new()).unwrap();
            let mut again = LogReader::open(&path).unwrap();
            let (mut kept, mut sorted) = (entries(&mut again), all.clone());
            kept.sort_by_key(LogEntry::topic);
            sorted.sort_by_key(LogEntry::topic);
            assert!(around_ticks.is_some() || kept == sorted);
            // Compressed, so that it depends on a library's version.
            fate.file_bytes = 0;
            let (end, plan, missing) =
                (again.end(), again.kept().unwrap(), again.missing().unwrap());
            let kept = sum(format!("{kept:?}").as_bytes());
            let text = format!("{fate:?}\n{end:?} {plan:?} missing {missing:?}\n{kept}");
            insta::assert_snapshot!(format!("{flight}.{name}"), text);
        }
    }
}
