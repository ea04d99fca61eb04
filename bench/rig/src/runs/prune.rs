//! `ironbird runs --prune`: removes old flights, file by file, and nothing that ironbird has not made.

use std::fs;
use std::path::{Path, PathBuf};

use model::role::ROLES;

use super::{RecordedRun, RunsArgs, size};
use crate::export;
use crate::output::print;
use crate::record::hlog;
use failure::{Failure, OK};
use report::text::count;

/// What a flight leaves beside its log and what its processes say; run.json, by which it is known, goes last.
const FILES: [&str; 11] = [
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
    LAST,
];
const LAST: &str = "run.json";

/// Removes what the flags ask for.
///
/// # Errors
/// [`Failure`] names the first file that resisted, after all others are gone.
pub(super) fn prune(runs: &[RecordedRun], args: &RunsArgs) -> Result<u8, Failure> {
    let kept = args.keep.map_or(0, |keep| usize::try_from(keep).unwrap_or(usize::MAX));
    let is_old = |run: &&RecordedRun| args.older_than.is_none_or(|age| run.age() > age);
    let (mut text, mut resisted) = (String::new(), None);
    let (mut removed, mut bytes) = (0, 0);
    for run in runs.iter().skip(kept).filter(is_old) {
        match why_not(run) {
            Some(why) => text += &format!("{} {}: {why}\n", if args.dry_run { "would keep" } else { "kept" }, run.name),
            None => {
                if let Err(failure) = if args.dry_run { Ok(()) } else { remove(&run.directory) } {
                    resisted.get_or_insert(failure);
                    continue;
                }
                let removes = if args.dry_run { "would remove" } else { "removed" };
                text += &format!("{removes} {} ({})\n", run.name, size(run.bytes));
                (removed, bytes) = (removed + 1, bytes + run.bytes);
            }
        }
    }
    let removes = if args.dry_run { "would be removed" } else { "removed" };
    text += &format!("{}, {} {removes}\n", count(removed, "flight"), size(bytes));
    print(&text)?;
    resisted.map_or(Ok(OK), Err)
}

/// Why a flight is not to be removed.
fn why_not(run: &RecordedRun) -> Option<String> {
    if run.is_latest {
        return Some("`latest` points to it".into());
    }
    if run.is_in_the_air() {
        return Some("it is in the air".into());
    }
    let foreign = foreign(&run.directory)?;
    Some(format!("{} was not created by ironbird", foreign.display()))
}

/// Something in a flight's directory that ironbird has not made.
fn foreign(directory: &Path) -> Option<PathBuf> {
    let exported = directory.join(export::DIRECTORY);
    others(directory, |name, is_directory| is_ours(name) && !is_directory || name == export::DIRECTORY && is_directory)
        .or_else(|| others(&exported, |name, is_directory| export::is_ours(name) && !is_directory))
}

/// The first entry of a directory, by name, that is none of ours.
fn others(directory: &Path, is_ours: impl Fn(&str, bool) -> bool) -> Option<PathBuf> {
    let entries = fs::read_dir(directory).into_iter().flatten().filter_map(Result::ok);
    let is_other = |entry: &fs::DirEntry| {
        let is_directory = entry.file_type().is_ok_and(|it| it.is_dir());
        !entry.file_name().to_str().is_some_and(|name| is_ours(name, is_directory))
    };
    entries.filter(is_other).map(|entry| entry.path()).min()
}

/// Whether a flight leaves a file of this name.
fn is_ours(name: &str) -> bool {
    let role = name.strip_suffix(".log").and_then(|name| ROLES.into_iter().find(|role| role.name() == name));
    FILES.contains(&name) || role.is_some() || flight_log::part_of(name).is_some()
}

/// Removes a flight's files and then its directory, which stays where something has come meanwhile.
fn remove(directory: &Path) -> Result<(), Failure> {
    let exported = directory.join(export::DIRECTORY);
    let files =
        [entries(&exported, export::is_ours), entries(directory, |name| is_ours(name) && name != LAST)].concat();
    for path in &files {
        fs::remove_file(path).map_err(|e| resists(path, &e))?;
    }
    if exported.is_dir() {
        fs::remove_dir(&exported).map_err(|e| resists(&exported, &e))?;
    }
    let last = directory.join(LAST);
    fs::remove_file(&last).map_err(|e| resists(&last, &e))?;
    fs::remove_dir(directory).map_err(|e| resists(directory, &e))
}

/// Entries of a directory by name.
fn entries(directory: &Path, is_wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).into_iter().flatten().filter_map(Result::ok);
    entries.filter(|entry| entry.file_name().to_str().is_some_and(&is_wanted)).map(|entry| entry.path()).collect()
}

fn resists(path: &Path, error: &std::io::Error) -> Failure {
    Failure::failed(format!("cannot remove {}: {error}", path.display()))
        .help("remove it yourself, or run this as the user who flew")
}
