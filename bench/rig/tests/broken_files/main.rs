//! Files that somebody hands over, broken in every way: each is read, or refused in words that name it.
//!
//! Real files are changed: bits, pieces, lengths, numbers, lines, values of a JSON tree, records of a log whose checksums
//! are then right. Each is read as the commands read it. A panic, a hang, much memory, or a refusal that does not name
//! the file fails the test, and the file is kept. `corpus` has files that once were trouble, and odd ones;
//! `IRONBIRD_BROKEN_S` and `IRONBIRD_BROKEN_SEED` say for how long and from where on.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod change;
#[path = "../recorded/mod.rs"]
mod recorded;
#[path = "../rig/mod.rs"]
mod rig;
mod trial;

use std::fs;
use std::path::Path;

use errors::{Failure, InFile as _, read_text};
use flight_log::entry::LogEntry;
use flight_log::perfetto::PerfettoWriter;
use flight_log::reader::LogReader;
use flight_log::rows;
use ironbird::replay::fly_again;
use ironbird::settings::law_settings::Moved;
use ironbird::settings::{DEFAULT, Settings};
use ironbird::simulator::Simulator;
use report::diff::{Flown, compare};
use report::json;
use report::render::brief;
use report::render::brief::Left;
use report::render::figures::Figures;
use report::render::{diff, flight, junit, picture};
use report::run_facts::RunFacts;
use report::schema::Report;
use toml::Value;

use recorded::{FaultKind, settings};
use rig::Rig;
use trial::Trial;

/// Ticks that are flown with settings that were taken.
const TICKS: u64 = 20;

fn good(name: &str) -> Vec<u8> {
    fs::read(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../..")
            .join(name),
    )
    .unwrap()
}

/// Takes off with settings that have passed every check.
fn flies(settings: Settings) -> Result<(), Failure> {
    settings.commented()?;
    settings.shared_text()?;
    let mut flight = Simulator::of(&settings)?;
    (0..TICKS.min(settings.last_tick())).for_each(|_| flight.tick());
    Ok(())
}

#[test]
fn settings_files() {
    let flown =
        b"[flight]\nduration_s = 2\nfaults = [\"mass_kg=0.6@1s\", \"rotational_drag_nm_s=+30%~500ms@tick900\"]\n\
        [inner]\nlaw = \"indi\"\n[outer]\nlaw = \"estimating\"\n[rt]\ncpu = \"auto\"\n[model]\nmass_kg = 0.5\n";
    let good = [DEFAULT.as_bytes().to_vec(), flown.to_vec()];
    let change = |dice: &mut _, file: &[u8]| change::bytes(dice, file, &good);
    let read = |path: &Path| flies(Settings::resolve(Some(path), &Vec::new())?);
    Trial {
        kind: "settings",
        file: "settings.toml",
        about: "settings.toml",
        good: &good,
        change: &change,
        read: &read,
    }
    .run();
}

#[test]
fn airframe_files() {
    let good = ["crazyflie", "paper", "x500"]
        .map(|name| good(&format!("bench/rig/airframes/{name}.toml")));
    let change = |dice: &mut _, file: &[u8]| change::bytes(dice, file, &good);
    let read = |path: &Path| {
        let named = Value::from(path.to_str().unwrap());
        flies(Settings::resolve(None, &vec![("flight.airframe", named)])?)
    };
    Trial {
        kind: "airframe",
        file: "airframe.toml",
        about: "airframe",
        good: &good,
        change: &change,
        read: &read,
    }
    .run();
}

#[test]
fn files_of_points() {
    let good = ["slalom", "stay"].map(|name| good(&format!("examples/{name}.csv")));
    let change = |dice: &mut _, file: &[u8]| change::bytes(dice, file, &good);
    let read = |path: &Path| {
        let named = Value::from(path.to_str().unwrap());
        flies(Settings::resolve(
            None,
            &vec![("flight.trajectory", named)],
        )?)
    };
    Trial {
        kind: "points",
        file: "points.csv",
        about: "points.csv",
        good: &good,
        change: &change,
        read: &read,
    }
    .run();
}

/// Reads a log to its end, and makes of it what an export does.
fn exported(path: &Path) -> Result<(), Failure> {
    let mut log = LogReader::open(path)?;
    let mut trace = PerfettoWriter::new(std::io::sink()).unwrap();
    while log.next_entry()?.is_some() {
        let line = match log.newest() {
            LogEntry::State(message) => trace.state(message).map(|()| rows::csv(message)),
            LogEntry::Setpoint(message) => trace.work(message).map(|()| rows::csv(message)),
            LogEntry::Wrench(message) => trace.work(message).map(|()| rows::json(message)),
            LogEntry::RotorSpeeds(message) => trace.work(message).map(|()| rows::json(message)),
            LogEntry::Swap(message) => trace.swap(message).map(|()| rows::csv(message)),
            LogEntry::Theorem(message) => Ok(rows::json(message)),
        };
        assert!(!line.unwrap().is_empty());
    }
    trace.finish().unwrap();
    log.missing().map(drop)
}

#[test]
fn flight_logs() {
    let text = "[flight]\nduration_s = 0.12\nfaults = [\"mass_kg=0.6@tick60\"]\n";
    let settings = settings(text);
    let trouble = |tick| FaultKind {
        mixer_sleeps: tick == 70,
        inner_sleeps: tick == 30,
        ..FaultKind::default()
    };
    let place = tempfile::tempdir_in("/dev/shm").unwrap();
    let path = place.path().join("flight.mcap");
    recorded::write(&path, &settings, &recorded::fly(&settings, trouble));
    let good = [fs::read(&path).unwrap()];
    // Only what has the right checksums gets far, and only a good log can be read to be changed.
    let change = |dice: &mut recorded::Dice, file: &[u8]| {
        if dice.roll(3) == 0 {
            None
        } else {
            change::log(dice, &good[0])
        }
        .unwrap_or_else(|| change::bytes(dice, file, &good))
    };
    let read = |path: &Path| {
        let exported = exported(path);
        fly_again(path, 0, false, &Moved::new())?;
        exported
    };
    Trial {
        kind: "log",
        file: "flight.mcap",
        about: "flight.mcap",
        good: &good,
        change: &change,
        read: &read,
    }
    .run();
}

#[test]
fn reports() {
    let rig = Rig::new("broken");
    let flown = |args: &[&str]| {
        rig.run(
            "fly",
            [
                &["--duration", "1s", "--fault", "mass_kg=0.6@tick500"],
                args,
            ]
            .concat(),
        )
        .expect(0);
        let path = |name: &str| rig.out().join("latest").join(name);
        let facts =
            serde_json::from_str::<RunFacts>(&fs::read_to_string(path("run.json")).unwrap())
                .unwrap();
        (
            fs::read(path("report.json")).unwrap(),
            fs::read(path("run.json")).unwrap(),
            facts,
        )
    };
    let slow = rig.slow(2);
    let (in_lockstep, facts_file, facts) = flown(&["--pace", "lockstep"]);
    let (on_the_clock, ..) = flown(&["--rt", "off", "--config", &slow]);
    let good = [in_lockstep, on_the_clock];
    let change = |dice: &mut recorded::Dice, file: &[u8]| {
        if dice.roll(3) == 0 {
            None
        } else {
            change::json(dice, file)
        }
        .unwrap_or_else(|| change::bytes(dice, file, &good))
    };
    let read_report = |path: &Path| {
        let report = Report::read(path)?;
        let left = Left {
            page: None,
            log: None,
        };
        let mut told = flight::text(&report)
            + &brief::render(&report, &left)
            + &flight::result_line(&report, "runs/x");
        let page = flight::page(&report);
        assert_eq!(page.matches("<script").count(), 1, "the page's own");
        told += &page;
        told += &json::to_string(&report).unwrap();
        if let Some(figures) = Figures::of(&report) {
            told += &picture::render(&figures, &flight::title(&report.run));
        }
        assert!(!told.contains('\u{1b}'), "an escape sequence");
        junit::write(&report, &path.with_extension("xml"))?;
        let flown = [Flown {
            run: "a".into(),
            report,
            facts: facts.clone(),
        }];
        assert!(!diff::render(&compare(&flown, &flown)).is_empty());
        Ok(())
    };
    Trial {
        kind: "report",
        file: "report.json",
        about: "report.json",
        good: &good,
        change: &change,
        read: &read_report,
    }
    .run();

    let report: Report = serde_json::from_slice(&good[0]).unwrap();
    let good = [facts_file];
    let change = |dice: &mut recorded::Dice, file: &[u8]| {
        if dice.roll(3) == 0 {
            None
        } else {
            change::json(dice, file)
        }
        .unwrap_or_else(|| change::bytes(dice, file, &good))
    };
    let read_facts = |path: &Path| {
        let facts =
            serde_json::from_str::<RunFacts>(&read_text("read", path)?).in_file("read", path)?;
        let flown = |facts: &RunFacts| Flown {
            run: "a".into(),
            report: report.clone(),
            facts: facts.clone(),
        };
        let b = Flown {
            facts: RunFacts {
                settings: serde_json::Value::Null,
                ..facts.clone()
            },
            ..flown(&facts)
        };
        assert!(!diff::render(&compare(&[flown(&facts)], &[b])).is_empty());
        Ok(())
    };
    Trial {
        kind: "facts",
        file: "run.json",
        about: "run.json",
        good: &good,
        change: &change,
        read: &read_facts,
    }
    .run();
}
