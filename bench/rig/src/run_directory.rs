//! The directory of a flight: named by time, never overwritten.
//!
//! The link `latest` beside it points to the newest flight that has a report.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use std::time::SystemTime;

use model::role::ROLES;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use toml::Table;

use crate::record::hlog;
use crate::settings::{LogName, Settings};
use crate::wall_time::file_stamp;
use failure::{Failure, InFile as _, open_file, read_text};
use flight_log::FILE;
use flight_log::reader::LogReader;
use machine::cpu_times::host;
use report::run_facts::RunFacts;

/// A flight's directory.
#[derive(Clone, Debug)]
pub struct RunDirectory {
    /// Where it is.
    pub path: PathBuf,
    /// Its run.json, locked as long as this lives: the flight has not ended.
    held: Option<Arc<File>>,
}

/// Whether the process that made a flight's directory lives.
#[must_use]
pub fn is_held(directory: &Path) -> bool {
    let locked = |file: File| flock(&file, FlockOperation::NonBlockingLockShared);
    open_file(&directory.join(FACTS)).is_ok_and(|file| locked(file) == Err(Errno::WOULDBLOCK))
}

/// The file that says what flew, by which a flight is known.
pub const FACTS: &str = "run.json";

/// What a flight leaves beside its log and what its processes say.
const FILES: [&str; 11] = [
    FACTS,
    "settings.toml",
    "report.json",
    "report.json.next",
    "report.json.draft",
    "report.txt",
    "report.html",
    "flight.svg",
    hlog::FILE,
    "states.csv",
    flight_log::perfetto::FILE,
];

/// Whether a flight leaves a file of this name.
#[must_use]
pub fn is_ours(name: &str) -> bool {
    let role = name.strip_suffix(".log").and_then(|name| ROLES.into_iter().find(|role| role.name() == name));
    FILES.contains(&name) || role.is_some() || flight_log::part_of(name).is_some()
}

/// Entries of a directory by name.
#[must_use]
pub fn entries(directory: &Path, is_wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).into_iter().flatten().filter_map(Result::ok);
    entries.filter(|entry| entry.file_name().to_str().is_some_and(&is_wanted)).map(|entry| entry.path()).collect()
}

/// The directory of flights: the one that was named, or that of the settings.
///
/// # Errors
/// Those of [`Settings::resolve`].
pub fn out_or_default(out: Option<&Path>) -> Result<PathBuf, Failure> {
    match out {
        Some(out) => Ok(out.to_owned()),
        None => Ok(PathBuf::from(Settings::resolve(None, &Vec::new())?.recorder.out)),
    }
}

impl RunDirectory {
    /// Makes a new directory below `out`, with run.json and settings.toml.
    ///
    /// # Errors
    /// A usage [`Failure`] names the directory that cannot be made.
    pub fn create(out: &Path, settings: &Settings, instance: &str) -> Result<Self, Failure> {
        let refused = |e: io::Error| {
            Failure::usage(format!("cannot record into {}: {e}", out.display()))
                .help("name a directory that you can write: --out DIR")
        };
        fs::create_dir_all(out).map_err(refused)?;
        let stamp = file_stamp(SystemTime::now());
        let mut name = stamp.clone();
        let mut copy = 1;
        let path = loop {
            let path = out.join(&name);
            match fs::create_dir(&path) {
                Ok(()) => break path,
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                    copy += 1;
                    name = format!("{stamp}-{copy}");
                }
                Err(e) => return Err(refused(e)),
            }
        };
        let mut directory = Self { path, held: None };
        match directory.describe(settings, instance) {
            Ok(()) => Ok(directory),
            Err(failure) => {
                directory.discard();
                Err(failure)
            }
        }
    }

    fn describe(&mut self, settings: &Settings, instance: &str) -> Result<(), Failure> {
        let facts = RunFacts {
            version: env!("CARGO_PKG_VERSION").into(),
            build: crate::build::here(),
            instance: instance.into(),
            settings: serde_json::to_value(settings).in_file("write", &self.path.join(FACTS))?,
            host: host(),
        };
        let file = self.path.join(FACTS);
        let text = serde_json::to_string_pretty(&facts).in_file("write", &file)?;
        let mut held = File::create_new(&file).in_file("write", &file)?;
        // Where the disk knows no locks, `is_held` says of nobody that he lives.
        let _ = flock(&held, FlockOperation::LockExclusive);
        held.write_all((text + "\n").as_bytes()).in_file("write", &file)?;
        self.held = Some(Arc::new(held));
        let file = self.settings_file();
        fs::write(&file, settings.commented()?).in_file("write", &file)
    }

    /// Removes a directory in which nothing was recorded; what is not of a flight's start stays, and so does it.
    pub fn discard(&self) {
        if self.path.join("report.json").exists() || holds_messages(&self.path.join(FILE)) {
            return;
        }
        for path in entries(&self.path, is_ours) {
            // Where it cannot go, the directory stays.
            let _ = fs::remove_file(path);
        }
        let _ = fs::remove_dir(&self.path);
    }

    /// The settings that a role of this flight is started with.
    #[must_use]
    pub fn settings_file(&self) -> PathBuf {
        self.path.join("settings.toml")
    }
}

/// Whether a flight log holds a message; one that cannot be read counts as if it did.
fn holds_messages(path: &Path) -> bool {
    let is_begun = fs::metadata(path).is_ok_and(|file| file.len() > 0);
    is_begun
        && !matches!(LogReader::open(path).and_then(|mut log| log.next_entry().map(|entry| entry.is_none())), Ok(true))
}

/// Points `latest`, beside a flight's directory, at it: done when the flight has a report.
///
/// # Errors
/// [`Failure`] names the link.
pub fn make_latest(directory: &Path) -> Result<(), Failure> {
    let (Some(out), Some(name)) = (directory.parent(), directory.file_name()) else { return Ok(()) };
    let link = out.join("latest");
    // Replaced in one step, so that `latest` always leads somewhere.
    let draft = out.join(format!(".latest.{}", std::process::id()));
    let made = symlink(name, &draft).and_then(|()| fs::rename(&draft, &link));
    if made.is_err() {
        let _ = fs::remove_file(&draft);
    }
    made.in_file("point to the flight with", &link)
}

/// The directory of a flight that was flown: by its path, or by its name below `out`.
///
/// # Errors
/// Usage, where there is none; names the flights that are there.
pub fn find(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    let out = out_or_default(out)?;
    let mut candidates = vec![run.to_owned(), out.join(run)];
    // An absolute path is the same below any directory.
    candidates.dedup();
    candidates.iter().find(|path| path.is_dir()).cloned().ok_or_else(|| {
        let places: Vec<String> = candidates.iter().map(|path| path.display().to_string()).collect();
        Failure::usage(format!("no flight at {}; {}", places.join(" or "), flights_in(&out)))
            .help("name a flight's directory, or `latest`; --out DIR says where flights were recorded")
    })
}

/// The newest flights of a directory, in words.
fn flights_in(out: &Path) -> String {
    const SHOWN: usize = 5;
    let mut flights: Vec<String> = fs::read_dir(out)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()).filter(|path| path.join(FACTS).is_file()))
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .filter(|name| name != "latest")
        .collect();
    flights.sort_by(|a, b| b.cmp(a));
    match flights.len() {
        0 => format!("{} holds no flight", out.display()),
        n if n > SHOWN => format!("{} holds {n}, the newest {}", out.display(), flights[..SHOWN].join(", ")),
        _ => format!("{} holds {}", out.display(), flights.join(", ")),
    }
}

/// The files of a flight's log, in order: of a long one the first may have been removed.
#[must_use]
pub fn log_files(directory: &Path) -> Vec<PathBuf> {
    let names =
        fs::read_dir(directory).into_iter().flatten().filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut parts: Vec<u64> = names.filter_map(|name| flight_log::part_of(&name)).collect();
    parts.sort_unstable();
    parts.into_iter().map(|part| directory.join(flight_log::file_name(part))).collect()
}

/// The first file of the log of a flight: of its directory, of `latest`, or the file itself.
///
/// # Errors
/// Usage, where there is no such flight or it has no log.
pub fn find_log(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    if run.is_file() {
        return Ok(run.to_owned());
    }
    let directory = find(run, out)?;
    if let Some(first) = log_files(&directory).first() {
        return Ok(first.clone());
    }
    let settings = read_text("read", &directory.join("settings.toml")).ok().and_then(|text| text.parse::<Table>().ok());
    let kept = settings.as_ref().and_then(|settings| settings.get("recorder")?.get("log")?.as_str());
    if kept == Some(LogName::Off.name()) {
        return Err(Failure::usage(format!(
            "{} holds no {FILE}: it was flown with recorder.log = \"off\"",
            directory.display()
        ))
        .help("name a flight that has one; `fly --log all` keeps every message, `--log around-misses` excerpts"));
    }
    let mut there: Vec<String> = fs::read_dir(&directory)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
        .collect();
    there.sort();
    Err(Failure::usage(format!("{} holds no {FILE}; it holds: {}", directory.display(), there.join(", ")))
        .help("name a flight that has one, or the file itself; flights of earlier versions have none"))
}
