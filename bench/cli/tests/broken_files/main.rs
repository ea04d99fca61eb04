//! Files of unknown origin, broken in every way: each is read, or refused by an error that names it.
//!
//! Real files are changed: bits, pieces, lengths, numbers, lines, values of a JSON tree, records of a log whose checksums
//! are then right. Each is read as the commands read it. A panic, a hang, much memory, or a refusal that does not name
//! the file fails the test, and the file is kept. `corpus` has files that once were trouble, and odd ones;
//! `IRONBIRD_BROKEN_S` and `IRONBIRD_BROKEN_SEED` say for how long and from where on.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod change;
#[path = "../recorded/mod.rs"]
mod recorded;
mod trial;

use std::fs;
use std::path::Path;

use analysis::diff::{ComparedRun, compare};
use analysis::json;
use analysis::report_file::RunFacts;
use analysis::schema::Report;
use config::Settings;
use config::declarations::DEFAULT;
use errors::{Failure, InFile as _, read_text};
use flight_log::entry::with_message;
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::LogReader;
use flight_log::rows;
use render::brief::Left;
use render::figures::Figures;
use render::{brief, diff, flight, junit, page, picture};
use replay::fly_again;
use sim::simulator::Simulator;
use toml::Value;

use fastrand::Rng;
use recorded::{TickFaults, settings};
use trial::Trial;

/// Ticks that are flown with settings that were taken.
const TICKS: u64 = 20;

fn good(name: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    fs::read(Path::new(root).join(name)).unwrap()
}

/// Takes off with settings that have passed every check.
fn flies(settings: Settings) -> Result<(), Failure> {
    settings.commented()?;
    settings.shared_text()?;
    let mut flight = Simulator::of(&settings)?;
    (0..TICKS.min(settings.last_tick())).for_each(|_| flight.tick());
    Ok(())
}

/// Files whose parts are changed in two of three cases, if `part` can read them, or else their bytes.
fn try_parts(
    kind: &'static str,
    file: &'static str,
    good: &[Vec<u8>],
    part: impl Fn(&mut Rng, &[u8]) -> Option<Vec<u8>>,
    read: &dyn Fn(&Path) -> Result<(), Failure>,
) {
    let change = |dice: &mut Rng, file: &[u8]| {
        let bytes_alone = dice.u64(..3) == 0;
        let changed = if bytes_alone { None } else { part(dice, file) };
        changed.unwrap_or_else(|| change::bytes(dice, file, good))
    };
    let trial = Trial {
        kind,
        file,
        good,
        change: &change,
        read,
    };
    trial.run();
}

fn flies_with(key: &'static str, path: &Path) -> Result<(), Failure> {
    let named = Value::from(path.to_str().unwrap());
    flies(Settings::resolve(None, &vec![(key, named)])?)
}

#[test]
fn settings_files() {
    let flown =
        b"[flight]\nduration_s = 2\nfaults = [\"mass_kg=0.6@1s\", \"rotational_drag_nm_s=+30%~500ms@tick900\"]\n\
        [inner]\nlaw = \"indi\"\n[outer]\nlaw = \"estimating\"\n[rt]\ncpu = \"auto\"\n[model]\nmass_kg = 0.5\n";
    let good = [DEFAULT.as_bytes().to_vec(), flown.to_vec()];
    try_parts("settings", "settings.toml", &good, |_, _| None, &|path| {
        flies(Settings::resolve(Some(path), &Vec::new())?)
    });
}

#[test]
fn airframe_files() {
    let good = ["crazyflie", "paper", "x500"]
        .map(|name| good(&format!("bench/config/airframes/{name}.toml")));
    try_parts("airframe", "airframe.toml", &good, |_, _| None, &|path| {
        flies_with("flight.airframe", path)
    });
}

#[test]
fn files_of_points() {
    let good = ["slalom", "stay"].map(|name| good(&format!("examples/{name}.csv")));
    try_parts("points", "points.csv", &good, |_, _| None, &|path| {
        flies_with("flight.trajectory", path)
    });
}

/// Reads a log to its end, and makes of it what an export does.
fn exported(path: &Path) -> Result<(), Failure> {
    let mut log = LogReader::open(path)?;
    let mut trace = PerfettoWriter::new(std::io::sink(), Vec::new(), None).unwrap();
    while log.next_entry()?.is_some() {
        let entry = log.newest();
        trace.take(entry).unwrap();
        let cells = with_message!(entry, it => rows::cells(it));
        assert!(!cells.is_empty());
    }
    trace.finish().unwrap();
    log.missing().map(drop)
}

#[test]
fn flight_logs() {
    let text = "[flight]\nduration_s = 0.12\nfaults = [\"mass_kg=0.6@tick60\"]\n";
    let settings = settings(text);
    let faults = |tick| TickFaults {
        silent: [false, false, tick == 30, tick == 70],
        ..TickFaults::default()
    };
    let place = tempfile::tempdir_in("/dev/shm").unwrap();
    let path = place.path().join("flight.mcap");
    recorded::write(&path, &settings, &recorded::fly(&settings, faults));
    let good = [fs::read(&path).unwrap()];
    let read = |path: &Path| {
        let exported = exported(path);
        fly_again(path, 0, false, &[])?;
        exported
    };
    // Only a log with the right checksums gets far, and only a good one can be read to be changed.
    let part = |dice: &mut Rng, _: &[u8]| change::log(dice, &good[0]);
    try_parts("log", "flight.mcap", &good, part, &read);
}

fn run_facts(path: &Path) -> Result<RunFacts, Failure> {
    serde_json::from_str(&read_text("read", path)?).in_file("read", path)
}

#[test]
fn reports() {
    let recorded = |file: &str| good(&format!("bench/render/tests/reports/{file}"));
    let facts_file = recorded("lockstep/run.json");
    let facts: RunFacts = serde_json::from_slice(&facts_file).unwrap();
    let good = ["lockstep/report.json", "outages/report.json"].map(recorded);
    let flown = |report: &Report, facts: &RunFacts| ComparedRun {
        run: "a".into(),
        report: report.clone(),
        facts: facts.clone(),
    };
    try_parts("report", "report.json", &good, change::json, &|path| {
        let report = Report::read(path)?;
        let page = page::render(&report);
        // With the data of the path, where there is one.
        let own = if report.traces.is_some() { 3 } else { 1 };
        assert_eq!(page.matches("<script").count(), own, "the page's own");
        let mut text = flight::text(&report)
            + &brief::render(&report, &Left::default())
            + &flight::result_line(&report, "runs/x")
            + &page
            + &json::to_string(&report).unwrap();
        if let Some(figures) = Figures::of(&report) {
            text += &picture::render(&figures, &flight::title(&report.run));
        }
        assert!(!text.contains('\u{1b}'), "an escape sequence");
        junit::write(&report, &path.with_extension("xml"))?;
        let flown = [flown(&report, &facts)];
        assert!(!diff::render(&compare(&flown, &flown)).is_empty());
        Ok(())
    });
    let report: Report = serde_json::from_slice(&good[0]).unwrap();
    try_parts("facts", "run.json", &[facts_file], change::json, &|path| {
        let a = flown(&report, &run_facts(path)?);
        let mut b = a.clone();
        b.facts.settings = serde_json::Value::Null;
        assert!(!diff::render(&compare(&[a], &[b])).is_empty());
        Ok(())
    });
}
