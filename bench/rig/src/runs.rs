//! `ironbird runs`: lists the flights that were recorded, and removes old ones.

mod prune;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use report::run_facts::RunFacts;
use report::schema::Report;
use serde::Serialize;

use crate::cli::values;
use crate::output::print;
use crate::record::hlog;
use crate::run_directory::{FACTS, is_held, out_or_default};
use crate::settings::airframe::PAPER;
use crate::settings::last_name;
use crate::wall_time::utc;
use failure::{Failure, OK, read_text};

/// Flags of `runs`.
#[derive(Clone, Debug, Args)]
pub struct RunsArgs {
    /// Directory of the flights [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long, conflicts_with = "prune")]
    pub json: bool,
    /// Remove old flights; `latest`, those in the air, and what ironbird has not made stay.
    #[arg(long, requires = "which")]
    pub prune: bool,
    /// Remove all but the newest N.
    #[arg(long, value_name = "N", requires = "prune", group = "which", allow_hyphen_values = true,
        value_parser = clap::value_parser!(u32).range(1..))]
    pub keep: Option<u32>,
    /// Remove those that began longer ago, as in 7d or 12h.
    #[arg(long, value_name = "AGE", requires = "prune", group = "which", allow_hyphen_values = true,
        value_parser = values::duration)]
    pub older_than: Option<Duration>,
    /// Say what would be removed, and remove nothing.
    #[arg(long, requires = "prune")]
    pub dry_run: bool,
}

/// A flight's directory.
#[derive(Debug, Serialize)]
struct RecordedRun {
    name: String,
    directory: PathBuf,
    /// When it began: for people, and for programs.
    started: String,
    started_unix_s: u64,
    /// `PASS` and so on; `starting`, `in the air`, `cut short` where its recorder has gone, `no report`, or
    /// `unreadable` where another version wrote it.
    status: String,
    /// Its flight time [s]; none without a report.
    length_s: Option<f64>,
    missed: Option<u64>,
    /// Its airframe, or the name of its file.
    airframe: String,
    /// Flight, timing and theorem; none without a report.
    words: Option<[String; 3]>,
    /// All of its files [bytes].
    bytes: u64,
    /// Whether `latest` points to it.
    is_latest: bool,
    /// Whether one of its processes lives.
    #[serde(skip)]
    is_alive: bool,
}

/// Lists flights, or removes old ones.
///
/// # Errors
/// Usage, where there is no such directory; [`Failure`] names what resisted.
pub fn runs(args: &RunsArgs) -> Result<u8, Failure> {
    let out = out_or_default(args.out.as_deref())?;
    let runs = recorded(&out)?;
    if args.prune {
        return prune::prune(&runs, args);
    }
    if args.json {
        let text = serde_json::to_string_pretty(&runs).map_err(|e| Failure::failed(e.to_string()))?;
        print(&(text + "\n"))?;
    } else {
        print(&table(&runs, &out))?;
    }
    Ok(OK)
}

/// The flights of a directory, the newest first.
fn recorded(out: &Path) -> Result<Vec<RecordedRun>, Failure> {
    let entries = fs::read_dir(out).map_err(|e| {
        Failure::usage(format!("cannot list the flights in {}: {e}", out.display()))
            .help("name the directory that flights were recorded into: --out DIR")
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
    /// What a directory tells; nothing where it is no flight's.
    fn of(directory: &Path, latest: Option<&Path>) -> Option<Self> {
        let facts = directory.join(FACTS);
        // A pipe may have no writer, and what a link leads to is somebody else's.
        if !facts.symlink_metadata().is_ok_and(|file| file.is_file()) {
            return None;
        }
        let RunFacts { settings, .. } = serde_json::from_str(&read_text("read", &facts).ok()?).ok()?;
        let report = Report::read(&directory.join("report.json")).ok();
        let made = fs::metadata(&facts).and_then(|it| it.modified()).unwrap_or(UNIX_EPOCH);
        let started = report.as_ref().map_or(made, |report| UNIX_EPOCH + Duration::from_nanos(report.run.run_id));
        let is_in_the_air = directory.join(hlog::FILE).exists() && hlog::lives(directory);
        let is_held = is_held(directory);
        let status = match &report {
            _ if is_in_the_air => "in the air".into(),
            None if is_held => "starting".into(),
            None if directory.join("report.json").exists() => "unreadable".into(),
            None => "no report".into(),
            Some(report) if report.run.in_flight => "cut short".into(),
            Some(report) => report.verdict.status.to_string(),
        };
        Some(Self {
            name: directory.file_name()?.to_string_lossy().into_owned(),
            directory: directory.to_owned(),
            started: report.as_ref().map_or_else(|| utc(made), |report| report.run.started.clone()),
            started_unix_s: started.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs(),
            status,
            length_s: report.as_ref().map(|it| (it.ticks.run + it.ticks.skipped) as f64 * it.run.period_us / 1e6),
            missed: report.as_ref().map(|it| it.deadlines.missed),
            airframe: last_name(settings["flight"]["airframe"].as_str().unwrap_or(PAPER)).to_owned(),
            words: report.map(|it| it.words.each().map(|(_, word, _)| word.to_owned())),
            bytes: bytes(directory),
            is_alive: is_in_the_air || is_held,
            is_latest: latest.is_some_and(|latest| fs::canonicalize(directory).is_ok_and(|it| it == latest)),
        })
    }

    fn age(&self) -> Duration {
        let started = UNIX_EPOCH + Duration::from_secs(self.started_unix_s);
        SystemTime::now().duration_since(started).unwrap_or_default()
    }

    fn row(&self) -> String {
        let length = self.length_s.map_or_else(|| "-".into(), length);
        let missed = self.missed.map_or_else(|| "-".into(), |missed| missed.to_string());
        let words = self.words.as_ref().map_or_else(|| "-".into(), |[flight, timing, _]| format!("{flight}, {timing}"));
        let name = self.name.replace(char::is_control, "?") + if self.is_latest { " *" } else { "" };
        // Most flights are of this one, and a row is to fit into 80 columns.
        let airframe = if self.airframe == PAPER { String::new() } else { format!(", {}", self.airframe) };
        let airframe = airframe.replace(char::is_control, "?");
        format!("{name:<22} {length:>6} {missed:>6} {:>6}  {:<11} {words}{airframe}\n", size(self.bytes), self.status)
    }
}

fn table(runs: &[RecordedRun], out: &Path) -> String {
    if runs.is_empty() {
        return format!("{} holds no flight\n", out.display());
    }
    let bytes = runs.iter().map(|run| run.bytes).sum();
    let mut text =
        format!("{:<22} {:>6} {:>6} {:>6}  {:<11} flight, timing\n", "flight", "length", "misses", "size", "status");
    text.extend(runs.iter().map(RecordedRun::row));
    let latest = if runs.iter().any(|run| run.is_latest) { "; * is `latest`" } else { "" };
    let others = runs.iter().any(|run| run.airframe != PAPER);
    let paper = if others { "; an airframe is named where it is not `paper`" } else { "" };
    text + &format!("{} in {}{latest}{paper}\n", report::text::count(runs.len() as u64, "flight"), size(bytes))
}

/// A length of time in at most six characters.
fn length(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.1}s"),
        s if s < 6000.0 => format!("{:.1}m", s / 60.0),
        s if s < 360_000.0 => format!("{:.1}h", s / 3600.0),
        s => format!("{:.1}d", s / 86_400.0),
    }
}

/// A number of bytes in at most six characters.
fn size(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["kB", "MB", "GB", "TB", "PB"];
    let mut number = bytes as f64 / 1e3;
    let mut unit = 0;
    while number >= 999.5 && unit + 1 < UNITS.len() {
        number /= 1e3;
        unit += 1;
    }
    let decimals = usize::from(number < 99.95);
    format!("{number:.decimals$}{}", UNITS[unit])
}

/// Length of everything in a directory [bytes]; links are not followed.
fn bytes(directory: &Path) -> u64 {
    let entries = fs::read_dir(directory).into_iter().flatten().filter_map(Result::ok);
    entries
        .map(|entry| match entry.metadata() {
            Ok(it) if it.is_dir() => bytes(&entry.path()),
            Ok(it) => it.len(),
            Err(_) => 0,
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_sizes_are_of_at_most_six_characters() {
        let lengths = [0.2, 99.94, 100.0, 5_999.0, 6_000.0, 359_999.0, 2_592_000.0].map(length);
        assert_eq!(lengths, ["0.2s", "99.9s", "1.7m", "100.0m", "1.7h", "100.0h", "30.0d"]);
        let sizes = [0, 99_949, 99_950, 999_499, 999_500, 19_300_000, 55_000_000_000].map(size);
        assert_eq!(sizes, ["0.0kB", "99.9kB", "100kB", "999kB", "1.0MB", "19.3MB", "55.0GB"]);
        assert!(lengths.iter().chain(&sizes).all(|text| text.len() <= 6));
    }
}
