//! `ironbird runs --prune`: removes old flights, file by file, and nothing that ironbird has not made.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::{RecordedRun, RunsArgs, size};
use crate::export;
use crate::output::print;
use crate::run_directory::{FACTS, entries, is_ours};
use failure::{Failure, OK};
use report::text::count;

/// Removes what the flags ask for.
///
/// # Errors
/// [`Failure`] counts the flights that resisted, after all others are gone; each is named with its reason.
pub(super) fn prune(runs: &[RecordedRun], args: &RunsArgs) -> Result<u8, Failure> {
    let kept = args.keep.map_or(0, |keep| usize::try_from(keep).unwrap_or(usize::MAX));
    let is_old = |run: &&RecordedRun| args.older_than.is_none_or(|age| run.age() > age);
    let mut text = String::new();
    let (mut removed, mut bytes, mut resisted) = (0, 0, 0);
    for run in runs.iter().skip(kept).filter(is_old) {
        match why_not(run) {
            Some(why) => text += &format!("{} {}: {why}\n", if args.dry_run { "would keep" } else { "kept" }, run.name),
            None => {
                if let Err(failure) = if args.dry_run { Ok(()) } else { remove(&run.directory) } {
                    text += &format!("removed in part {}: {failure}\n", run.name);
                    resisted += 1;
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
    if resisted == 0 {
        return Ok(OK);
    }
    Err(Failure::failed(format!("{} could not be removed", count(resisted, "flight")))
        .help("remove what is named yourself, or run this as the user who flew"))
}

/// Why a flight is not to be removed.
fn why_not(run: &RecordedRun) -> Option<String> {
    if run.is_latest {
        return Some("`latest` points to it".into());
    }
    if run.is_alive {
        return Some("its processes live".into());
    }
    let exported = run.directory.join(export::DIRECTORY);
    if let Some(e) = fs::read_dir(&exported).err().filter(|e| e.kind() != ErrorKind::NotFound) {
        return Some(format!("cannot look into {}: {e}", exported.display()));
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

/// Removes a flight's files and then its directory, which stays where something has come meanwhile.
fn remove(directory: &Path) -> Result<(), Failure> {
    let exported = directory.join(export::DIRECTORY);
    let files =
        [entries(&exported, export::is_ours), entries(directory, |name| is_ours(name) && name != FACTS)].concat();
    for path in &files {
        gone(path, fs::remove_file(path))?;
    }
    gone(&exported, fs::remove_dir(&exported))?;
    let last = directory.join(FACTS);
    gone(&last, fs::remove_file(&last))?;
    gone(directory, fs::remove_dir(directory))
}

/// What is not there any more, somebody else has removed.
fn gone(path: &Path, removed: io::Result<()>) -> Result<(), Failure> {
    match removed {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(resists(path, &e)),
        _ => Ok(()),
    }
}

fn resists(path: &Path, error: &io::Error) -> Failure {
    Failure::failed(format!("cannot remove {}: {error}", path.display()))
}
