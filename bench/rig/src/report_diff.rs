//! `ironbird report diff`: reads flights and prints how two of them, or two groups of them, compare.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use failure::{Failure, InFile as _, OK, read_text};
use report::diff::{Flown, compare, text};
use report::json;

use crate::cli::{DiffArgs, DiffFormat};
use crate::output::print;
use crate::run_directory::find;
use crate::show_report::read;

/// Compares.
///
/// # Errors
/// Usage, where a flight or its report is not there, or is not at its end, or is named twice.
pub fn diff(args: &DiffArgs) -> Result<u8, Failure> {
    let (a, b) = groups(args)?;
    let found = |runs: &[PathBuf]| -> Result<Vec<PathBuf>, Failure> {
        runs.iter().map(|run| find(run, args.out.as_deref())).collect()
    };
    let (a, b) = (found(a)?, found(b)?);
    if let Some(twice) = twice(&a, &b) {
        return Err(Failure::usage(format!("{} is named twice", twice.display()))
            .help("a flight cannot be compared with itself: name different flights"));
    }
    let flown = |runs: &[PathBuf]| runs.iter().map(|run| flown(run)).collect::<Result<Vec<_>, Failure>>();
    let diff = compare(&flown(&a)?, &flown(&b)?);
    match args.format {
        DiffFormat::Text => print(&text::render(&diff))?,
        DiffFormat::Json => print(&(json::to_string(&diff).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
    }
    Ok(OK)
}

/// The two groups as they were typed: `A B`, or `A1 A2 .. -- B1 B2 ..`.
fn groups(args: &DiffArgs) -> Result<(&[PathBuf], &[PathBuf]), Failure> {
    match (&args.a[..], &args.b[..]) {
        ([a, b], []) => Ok((std::slice::from_ref(a), std::slice::from_ref(b))),
        (some, []) => Err(Failure::usage(match some.len() {
            1 => "one flight and no `--`: two are compared, or two groups".to_owned(),
            several => format!("{several} flights and no `--`: which are A and which are B?"),
        })
        .help("ironbird report diff A B, or ironbird report diff A1 A2 A3 -- B1 B2 B3")),
        (a, b) => match b.iter().find(|run| run.as_os_str().as_encoded_bytes().starts_with(b"-")) {
            Some(flag) => Err(Failure::usage(format!("{}: behind `--` stand flights and no flags", flag.display()))
                .help("ironbird report diff --format json A1 A2 A3 -- B1 B2 B3")),
            None => Ok((a, b)),
        },
    }
}

/// A flight that is named more than once, however its path is spelled.
fn twice<'a>(a: &'a [PathBuf], b: &'a [PathBuf]) -> Option<&'a Path> {
    let mut seen = BTreeSet::new();
    a.iter()
        .chain(b)
        .find(|run| !seen.insert(run.canonicalize().unwrap_or_else(|_| (*run).clone())))
        .map(PathBuf::as_path)
}

/// The flight of a directory.
fn flown(directory: &Path) -> Result<Flown, Failure> {
    let report = read(directory)?;
    if report.distributions.is_empty() {
        return Err(Failure::usage(format!(
            "{} has no final report with distributions, so that nothing can be said of its percentiles",
            directory.display()
        ))
        .help("wait for the flight's end; a flight whose recorder died, or of an older version, has none"));
    }
    let path = directory.join("run.json");
    let text = read_text("read", &path)?;
    let facts = serde_json::from_str(&text).in_file("read", &path)?;
    Ok(Flown { run: directory.display().to_string(), report, facts })
}
