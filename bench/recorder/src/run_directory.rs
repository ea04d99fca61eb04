//! The directory of a flight: named by its start time, never overwritten.
//!
//! The link `latest` next to it points to the newest flight with a report.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use std::time::SystemTime;

use messages::role::{Channel, MOST_CHANNELS, Replica};
use rustix::fs::{FlockOperation, MemfdFlags, flock, memfd_create};
use rustix::io::Errno;
use toml::Table;

use analysis::report_file::RunFacts;
use analysis::schema::Report;
use config::Settings;
use errors::{Failure, InFile as _, open_file, read_text};
use flight_log::FILE;
use flight_log::facts::OFF;
use flight_log::reader::LogReader;
use flight_log::wall_time::file_stamp;
use host::cpu_times::host;

#[derive(Clone, Debug)]
pub struct RunDirectory {
    pub path: PathBuf,
    /// The file run.json, locked until this value is dropped: the flight has not ended.
    held: Option<Arc<File>>,
    /// A file in memory, which the recorder gets as standard input to hand over its final report, whatever the disk does.
    pub memory: Arc<File>,
}

/// Whether the process that created a run directory still runs.
pub fn is_held(directory: &Path) -> bool {
    let locked = |file: File| flock(&file, FlockOperation::NonBlockingLockShared);
    open_file(&directory.join(FACTS)).is_ok_and(|file| locked(file) == Err(Errno::WOULDBLOCK))
}

/// The file with build, settings and host; a directory with this file is a flight.
pub const FACTS: &str = "run.json";
/// The file with every latency series; its recorder holds a lock on it.
pub const LATENCIES: &str = "latency.hlog";
/// The link to the newest flight.
pub const LATEST: &str = "latest";

pub const SETTINGS: &str = "settings.toml";

/// Files of a flight besides its log and the output of its processes.
const FILES: [&str; 9] = [
    FACTS,
    SETTINGS,
    "report.json",
    "report.txt",
    "report.html",
    "flight.svg",
    LATENCIES,
    "states.csv",
    flight_log::perfetto::FILE,
];

/// Whether a flight creates a file of this name.
pub fn is_ours(name: &str) -> bool {
    let of_process = |name: &str| Replica::all(MOST_CHANNELS).any(|it| it.to_string() == name);
    FILES.contains(&name)
        || name.ends_with(".aside") && FILES.iter().any(|file| name.starts_with(file))
        || name.strip_suffix(".log").is_some_and(of_process)
        || flight_log::part_of(name).is_some()
}

fn names(directory: &Path) -> impl Iterator<Item = String> {
    let entries = fs::read_dir(directory).into_iter().flatten();
    entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok())
}

pub fn entries(directory: &Path, is_wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let wanted = names(directory).filter(|name| is_wanted(name));
    wanted.map(|name| directory.join(name)).collect()
}

/// The directory with all flights: the given one, or the one in the settings.
pub fn out_or_default(out: Option<&Path>) -> Result<PathBuf, Failure> {
    match out {
        Some(out) => Ok(out.to_owned()),
        None => Ok(PathBuf::from(
            Settings::resolve(None, &Vec::new())?.recorder.out,
        )),
    }
}

impl RunDirectory {
    /// Creates a new directory in `out`, with run.json and settings.toml.
    pub fn create(out: &Path, settings: &Settings, instance: &str) -> Result<Self, Failure> {
        let refused = |e: io::Error| {
            Failure::usage(format!("cannot record into {}: {e}", out.display()))
                .help("name a writable directory: --out DIR")
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
        let memory = memfd_create("report", MemfdFlags::CLOEXEC);
        let memory = memory.map_err(|e| Failure::failed(format!("no memory for a report: {e}")))?;
        let (held, memory) = (None, Arc::new(memory.into()));
        let mut directory = Self { path, held, memory };
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
            build: flight_log::build::executable(),
            instance: instance.into(),
            settings: serde_json::to_value(settings).in_file("write", &self.path.join(FACTS))?,
            host: host(),
        };
        let file = self.path.join(FACTS);
        let text = serde_json::to_string_pretty(&facts).in_file("write", &file)?;
        let mut held = File::create_new(&file).in_file("write", &file)?;
        // On a file system without locks, `is_held` is always false.
        let _ = flock(&held, FlockOperation::LockExclusive);
        held.write_all((text + "\n").as_bytes())
            .in_file("write", &file)?;
        self.held = Some(Arc::new(held));
        let file = self.settings_file();
        fs::write(&file, settings.commented()?).in_file("write", &file)
    }

    /// Removes the directory if nothing was recorded. Files that ironbird did not create stay, and the directory too.
    pub fn discard(&self) {
        if self.path.join("report.json").exists() || holds_messages(&self.path.join(FILE)) {
            return;
        }
        for channel in Channel::ALL {
            let directory = self.path.join(flight_log::log_directory(channel));
            for log in entries(&directory, |name| flight_log::part_of(name).is_some()) {
                let _ = fs::remove_file(log);
            }
            let _ = fs::remove_dir(directory);
        }
        for path in entries(&self.path, is_ours) {
            // If a file cannot be removed, the directory stays.
            let _ = fs::remove_file(path);
        }
        let _ = fs::remove_dir(&self.path);
    }

    /// The last report of its recorder, if there is one. To be called once: what was handed over is then read.
    pub fn report(&self) -> Result<Option<Report>, Failure> {
        let path = self.path.join("report.json");
        let handed_over = io::read_to_string(&*self.memory).unwrap_or_default();
        match Report::of(&handed_over, &path) {
            Ok(report) => Ok(Some(report)),
            Err(_) => path.exists().then(|| Report::read(&path)).transpose(),
        }
    }

    pub fn settings_file(&self) -> PathBuf {
        self.path.join(SETTINGS)
    }
}

/// Whether a flight log contains a message; true if it cannot be read.
fn holds_messages(path: &Path) -> bool {
    let is_begun = fs::metadata(path).is_ok_and(|file| file.len() > 0);
    is_begun
        && !matches!(
            LogReader::open(path).and_then(|mut log| log.next_entry().map(|entry| entry.is_none())),
            Ok(true)
        )
}

/// Refuses to replace a `latest` that is no link.
pub fn check_latest(directory: &Path) -> Result<(), Failure> {
    let latest = directory.with_file_name(LATEST);
    match fs::symlink_metadata(&latest) {
        Ok(it) if !it.is_symlink() => {
            let what = format!("{} is not a link, and was left as it is", latest.display());
            Err(Failure::failed(what))
        }
        _ => Ok(()),
    }
}

/// Makes the link `latest` point to a run directory that has a report.
pub fn make_latest(directory: &Path) -> Result<(), Failure> {
    let (Some(out), Some(name)) = (directory.parent(), directory.file_name()) else {
        return Ok(());
    };
    if !directory.join("report.json").exists() {
        return Ok(());
    }
    check_latest(directory)?;
    let link = out.join(LATEST);
    // Replaced in one step, so that `latest` always points to a flight.
    let draft = out.join(format!(".latest.{}", std::process::id()));
    let made = symlink(name, &draft).and_then(|()| fs::rename(&draft, &link));
    if made.is_err() {
        let _ = fs::remove_file(&draft);
    }
    made.in_file("point to the flight with", &link)
}

const FIND: &str =
    "name a run directory or `latest`; --out DIR names the directory with all flights";

/// Finds a run directory: by its path, or by its name in `out`.
pub fn find(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    let out = out_or_default(out)?;
    if run.as_os_str().is_empty() {
        let what = format!("an empty path is no flight; {}", flights_in(&out));
        return Err(Failure::usage(what).help(FIND));
    }
    let mut candidates = vec![run.to_owned(), out.join(run)];
    // An absolute path gives the same candidate twice.
    candidates.dedup();
    if let Some(found) = candidates.iter().find(|path| path.is_dir()) {
        return Ok(found.clone());
    }
    let places = candidates.iter().map(|path| path.display().to_string());
    let places: Vec<String> = places.collect();
    Err(Failure::usage(format!(
        "no flight at {}; {}",
        places.join(" or "),
        flights_in(&out)
    ))
    .help(FIND))
}

/// The newest flights of a directory, as text.
fn flights_in(out: &Path) -> String {
    const SHOWN: usize = 5;
    let is_flight = |name: &String| name != "latest" && out.join(name).join(FACTS).is_file();
    let mut flights: Vec<String> = names(out).filter(is_flight).collect();
    flights.sort_by(|a, b| b.cmp(a));
    match flights.len() {
        0 => format!("{} holds no flight", out.display()),
        n if n > SHOWN => format!(
            "{} holds {n}, the newest {}",
            out.display(),
            flights[..SHOWN].join(", ")
        ),
        _ => format!("{} holds {}", out.display(), flights.join(", ")),
    }
}

/// The files of a flight's log, in order. The first ones of a long log may have been removed.
pub fn log_files(directory: &Path) -> Vec<PathBuf> {
    let mut parts: Vec<u64> = names(directory)
        .filter_map(|name| flight_log::part_of(&name))
        .collect();
    parts.sort_unstable();
    let path = |part| directory.join(flight_log::file_name(part));
    parts.into_iter().map(path).collect()
}

/// The first file of a flight's log; `run` is a run directory, `latest`, or the file itself.
pub fn find_log(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    if run.is_file() {
        return Ok(run.to_owned());
    }
    let directory = find(run, out)?;
    if let Some(first) = log_files(&directory).first() {
        return Ok(first.clone());
    }
    let place = directory.display();
    let settings = read_text("read", &directory.join(SETTINGS)).unwrap_or_default();
    let settings: Table = settings.parse().unwrap_or_default();
    let log = settings
        .get("recorder")
        .and_then(|recorder| recorder.get("log")?.as_str());
    if log == Some(OFF) {
        return Err(Failure::usage(format!(
            "{place} holds no {FILE}: it was flown with recorder.log = \"off\""
        ))
        .help("name a flight that has one; `fly --log all` logs every message, `--log around-misses` excerpts"));
    }
    let mut there: Vec<String> = names(&directory).collect();
    there.sort();
    let there = there.join(", ");
    Err(
        Failure::usage(format!("{place} holds no {FILE}; it holds: {there}"))
            .help("name a flight that has one, or the file itself"),
    )
}
