//! `ironbird runs`: lists the flights that were recorded, and removes old ones.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use analysis::phrase::{count, name_of};
use analysis::report_file::RunFacts;
use analysis::schema::{NotFresh, Report, TimingVerdict};
use render::document::{Cell, Table, known, row};
use serde::Serialize;

use crate::cli::RunsArgs;
use crate::export;
use crate::report_command::abandon;
use analysis::json::print_json;
use config::airframe::PAPER;
use config::{last_name, utf8};
use errors::output::print;
use errors::{Failure, OK};
use flight_log::wall_time::utc;
use messages::role::Channel;
use recorder::hlog;
use recorder::run_directory::{FACTS, LATENCIES, entries, is_held, is_ours, out_or_default};

#[derive(Debug, Serialize)]
struct RecordedRun {
    name: String,
    directory: PathBuf,
    started: String,
    started_unix_s: u64,
    /// The verdict; or `starting`, `in the air`, `recorder ended`, `no report`, or `unreadable` (written by
    /// another version).
    status: String,
    /// Flight time [s]; none without a report.
    length_s: Option<f64>,
    missed: Option<u64>,
    /// None in lockstep.
    not_fresh: Option<NotFresh>,
    /// Airframe, or the name of its file.
    airframe: String,
    /// Verdicts on flight, timing and theorem; none without a report.
    words: Option<[String; 3]>,
    /// Size of all files [bytes].
    bytes: u64,
    is_latest: bool,
    #[serde(skip)]
    is_alive: bool,
}

pub fn runs(args: &RunsArgs) -> Result<u8, Failure> {
    let out = out_or_default(args.out.as_deref())?;
    let runs = recorded(&out)?;
    if args.prune {
        return prune(&runs, args);
    }
    match args.json {
        true => {
            utf8(&out)?;
            print_json(&runs)?;
        }
        false => print(&table(&runs, &out))?,
    }
    Ok(OK)
}

/// The flights of a directory, the newest first.
fn recorded(out: &Path) -> Result<Vec<RecordedRun>, Failure> {
    let entries = fs::read_dir(out).map_err(|e| {
        Failure::usage(format!("cannot list the flights in {}: {e}", out.display()))
            .help("name the directory with the recorded flights: --out DIR")
    })?;
    let latest = fs::canonicalize(out.join("latest")).ok();
    let mut runs: Vec<RecordedRun> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.symlink_metadata().is_ok_and(|it| it.is_dir()))
        .filter_map(|path| RecordedRun::of(&path, latest.as_deref()))
        .collect();
    runs.sort_by(|a, b| (b.started_unix_s, &b.name).cmp(&(a.started_unix_s, &a.name)));
    Ok(runs)
}

impl RecordedRun {
    /// Describes the flight of a directory; none if it is not a run directory.
    fn of(directory: &Path, latest: Option<&Path>) -> Option<Self> {
        let facts = directory.join(FACTS);
        // Opening a pipe could block, and a link may point to another user's file.
        if !facts.symlink_metadata().is_ok_and(|file| file.is_file()) {
            return None;
        }
        let RunFacts { settings, .. } = RunFacts::read(&facts).ok()?;
        let airframe = settings["flight"]["airframe"].as_str().unwrap_or(PAPER);
        let report_file = directory.join("report.json");
        let is_in_the_air = directory.join(LATENCIES).exists() && hlog::lives(directory);
        let is_held = is_held(directory);
        let mut report = Report::read(&report_file).ok();
        let unfinished = report.as_mut().filter(|it| it.run.in_flight);
        let unfinished = unfinished.filter(|_| !is_in_the_air);
        let has_ended_early = unfinished.map(|it| abandon(it, directory)).is_some();
        let report = report.as_ref();
        let modified = fs::metadata(&facts).and_then(|it| it.modified());
        let made = modified.unwrap_or(UNIX_EPOCH);
        let started_at = |report: &Report| UNIX_EPOCH + Duration::from_nanos(report.run.run_id);
        let started_after = report.map_or(made, started_at).duration_since(UNIX_EPOCH);
        let status = match report {
            _ if is_in_the_air => "in the air".into(),
            None if is_held => "starting".into(),
            None if report_file.exists() => "unreadable".into(),
            None => "no report".into(),
            Some(_) if has_ended_early => "recorder ended".into(),
            Some(report) => report.verdict.status.to_string(),
        };
        let length_s = |it: &Report| it.ticks.flown_s(&it.run);
        Some(Self {
            name: directory.file_name()?.to_string_lossy().into_owned(),
            directory: directory.to_owned(),
            started: report.map_or_else(|| utc(made), |report| report.run.started.clone()),
            started_unix_s: started_after.unwrap_or_default().as_secs(),
            status,
            length_s: report.map(length_s),
            missed: report.map(|it| it.deadlines.missed),
            not_fresh: report.and_then(|it| it.deadlines.not_fresh),
            airframe: last_name(airframe).to_owned(),
            words: report.map(|it| render::sentences::verdicts(&it.words).map(|(_, word, _)| word)),
            bytes: bytes(directory),
            is_alive: is_in_the_air || is_held,
            is_latest: latest.is_some() && fs::canonicalize(directory).ok().as_deref() == latest,
        })
    }

    fn age(&self) -> Duration {
        let started = UNIX_EPOCH + Duration::from_secs(self.started_unix_s);
        started.elapsed().unwrap_or_default()
    }

    fn row(&self) -> Vec<Cell> {
        let on_time = |it: NotFresh| format!("{:.2} %", it.on_time_percent());
        let verdicts = self.words.as_ref();
        let not_measured = name_of(&TimingVerdict::NotMeasured);
        let verdicts = known(
            verdicts.map(|[flight, timing, _]| match *timing == not_measured {
                true => flight.clone(),
                false => format!("{flight}, {timing}"),
            }),
        );
        let name = self.name.replace(char::is_control, "?");
        let latest = if self.is_latest { " *" } else { "" };
        // Omitted for the most common airframe, so that a row fits into 80 columns.
        let airframe = match self.airframe.as_str() {
            PAPER => String::new(),
            other => format!(", {}", other.replace(char::is_control, "?")),
        };
        row([
            &format!("{name}{latest}"),
            &known(self.length_s.map(length)),
            &known(self.not_fresh.map(on_time)),
            &size(self.bytes),
            &self.status,
            &format!("{verdicts}{airframe}"),
        ])
    }
}

fn table(runs: &[RecordedRun], out: &Path) -> String {
    if runs.is_empty() {
        return format!("{} holds no flight\n", out.display());
    }
    let columns = "flight;length;on time;size;status;flight, timing".split(';');
    let table = Table::new(columns, runs.iter().map(RecordedRun::row)).list();
    let note = |is_needed: bool, text: &'static str| if is_needed { text } else { "" };
    format!(
        "{table}{} in {}{}{}\non time: share of the ticks with a fresh command on time\n",
        count(runs.len() as u64, "flight"),
        size(runs.iter().map(|run| run.bytes).sum()),
        note(runs.iter().any(|run| run.is_latest), "; * is `latest`"),
        note(
            runs.iter().any(|run| run.airframe != PAPER),
            "; an airframe is named where it is not `paper`"
        ),
    )
}

/// A duration in at most six characters.
fn length(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.1}s"),
        s if s < 6000.0 => format!("{:.1}m", s / 60.0),
        s if s < 360_000.0 => format!("{:.1}h", s / 3600.0),
        s => format!("{:.1}d", s / 86_400.0),
    }
}

/// A number of bytes in at most six characters.
pub(crate) fn size(bytes: u64) -> String {
    let mut number = bytes as f64 / 1e3;
    let mut units = ["kB", "MB", "GB", "TB"].into_iter();
    let unit = loop {
        match units.next() {
            Some(_) if number >= 999.5 => number /= 1e3,
            unit => break unit.unwrap_or("PB"),
        }
    };
    let decimals = usize::from(number < 99.95);
    format!("{number:.decimals$}{unit}")
}

/// Size of everything in a directory [bytes]; links are not followed.
fn bytes(directory: &Path) -> u64 {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    let size = |entry: fs::DirEntry| match entry.metadata() {
        Ok(it) if it.is_dir() => bytes(&entry.path()),
        Ok(it) => it.len(),
        Err(_) => 0,
    };
    entries.map(size).sum()
}

/// Removes the flights selected by the flags, file by file, and nothing that ironbird did not create.
///
/// Continues after a flight that cannot be removed; the error gives the number of those.
fn prune(runs: &[RecordedRun], args: &RunsArgs) -> Result<u8, Failure> {
    let [would, removed, be_removed] = match args.dry_run {
        true => ["would keep", "would remove", "would be removed"],
        false => ["kept", "removed", "removed"],
    };
    let kept = args.keep.unwrap_or(0) as usize;
    let is_old = |run: &&RecordedRun| args.older_than.is_none_or(|age| run.age() > age);
    let mut text = String::new();
    let (mut flights, mut bytes, mut failed) = (0, 0, 0);
    for run in runs.iter().skip(kept).filter(is_old) {
        let name = &run.name;
        if let Some(why) = reason_to_keep(run) {
            text += &format!("{would} {name}: {why}\n");
        } else if let Err(failure) = remove(&run.directory, args.dry_run) {
            let is_whole = self::bytes(&run.directory) == run.bytes;
            let some = if is_whole { "not" } else { "partly" };
            text += &format!("{some} removed {name}: {failure}\n");
            failed += 1;
        } else {
            text += &format!("{removed} {name} ({})\n", size(run.bytes));
            (flights, bytes) = (flights + 1, bytes + run.bytes);
        }
    }
    let (flights, size) = (count(flights, "flight"), size(bytes));
    text += &format!("{flights}, {size} {be_removed}\n");
    print(&text)?;
    if failed == 0 {
        return Ok(OK);
    }
    let what = format!("{} could not be removed", count(failed, "flight"));
    Err(Failure::failed(what)
        .help("remove the files named above yourself, or run this as the user who recorded them"))
}

fn reason_to_keep(run: &RecordedRun) -> Option<String> {
    if run.is_latest {
        return Some("`latest` points to it".into());
    }
    if run.is_alive {
        return Some("its processes are running".into());
    }
    let directories = directories(&run.directory);
    for (directory, is_ours) in &directories {
        let entries = match fs::read_dir(directory) {
            Err(e) if e.kind() == ErrorKind::NotFound => continue,
            Err(e) => return Some(format!("cannot list {}: {e}", directory.display())),
            Ok(entries) => entries.flatten(),
        };
        let is_foreign = |entry: &fs::DirEntry| match entry.file_type().is_ok_and(|it| it.is_dir())
        {
            true => !directories.iter().any(|(known, _)| *known == entry.path()),
            false => !entry.file_name().to_str().is_some_and(is_ours),
        };
        if let Some(foreign) = entries.filter(is_foreign).map(|it| it.path()).min() {
            return Some(format!("{} was not created by ironbird", foreign.display()));
        }
    }
    None
}

type IsOurs = fn(&str) -> bool;

/// The directory of a flight and those in it, and which files in them are its own.
fn directories(run: &Path) -> Vec<(PathBuf, IsOurs)> {
    let is_log: IsOurs = |name| flight_log::part_of(name).is_some();
    let own: (PathBuf, IsOurs) = (run.to_owned(), is_ours);
    let logs = Channel::ALL.map(|channel| (run.join(flight_log::log_directory(channel)), is_log));
    let exported: (PathBuf, IsOurs) = (run.join(export::DIRECTORY), export::is_ours);
    [own].into_iter().chain(logs).chain([exported]).collect()
}

/// Removes a flight's files and then its directory, unless a new file has appeared meanwhile.
fn remove(run: &Path, dry_run: bool) -> Result<(), Failure> {
    if dry_run {
        return Ok(());
    }
    for (directory, is_ours) in directories(run).into_iter().rev() {
        let mut files = entries(&directory, is_ours);
        // Without it, the rest would be no flight.
        files.sort_by_key(|path| path.ends_with(FACTS));
        for path in files {
            ensure_removed(&path, fs::remove_file(&path))?;
        }
        ensure_removed(&directory, fs::remove_dir(&directory))?;
    }
    Ok(())
}

/// Ignores that a file no longer exists.
fn ensure_removed(path: &Path, removed: io::Result<()>) -> Result<(), Failure> {
    match removed {
        Err(e) if e.kind() != ErrorKind::NotFound => {
            let what = format!("cannot remove {}: {e}", path.display());
            Err(Failure::failed(what))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_sizes_have_at_most_six_characters() {
        for (seconds, text) in [
            (0.2, "0.2s"),
            (99.94, "99.9s"),
            (100.0, "1.7m"),
            (5_999.0, "100.0m"),
            (6_000.0, "1.7h"),
            (359_999.0, "100.0h"),
            (2_592_000.0, "30.0d"),
        ] {
            assert_eq!(length(seconds), text);
        }
        for (bytes, text) in [
            (0, "0.0kB"),
            (99_949, "99.9kB"),
            (99_950, "100kB"),
            (999_499, "999kB"),
            (999_500, "1.0MB"),
            (19_300_000, "19.3MB"),
            (55_000_000_000, "55.0GB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }
}
