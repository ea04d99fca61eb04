//! `ironbird report`: prints the report of a flight, also while it is running; `report diff` compares flights.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::browser::open_page;
use crate::cli::{DiffArgs, DiffFormat, Format, ReportArgs, ReportCommand};
use crate::margin::table::look_again;
use crate::output::print;
use crate::record::hlog;
use crate::run_directory::{find, log_files};
use crate::wall_time::utc;
use errors::{Failure, InFile as _, OK, check_writable, read_text};
use report::diff::{Flown, compare};
use report::gates::break_off;
use report::json;
use report::render::brief;
use report::render::brief::Left;
use report::render::{diff, flight, junit};
use report::schema::Report;
use report::status::FlightStatus;

pub fn show(args: &ReportArgs) -> Result<u8, Failure> {
    if let Some(ReportCommand::Diff(args)) = &args.command {
        return diff(args);
    }
    check_writable("--junit", args.junit.as_deref())?;
    let found = find(&args.run, args.out.as_deref())?;
    // Print the real name: `latest` will point to another flight later.
    let directory =
        fs::read_link(&found).map_or_else(|_| found.clone(), |name| found.with_file_name(name));
    let mut report = read(&directory)?;
    if report.run.in_flight && !hlog::lives(&directory) {
        // The recorder may have written the final report meanwhile.
        report = read(&directory)?;
        abandoned(&mut report, &directory);
    }
    look_again(&mut report, &directory);
    if let Some(path) = &args.junit {
        junit::write(&report, path)?;
    }
    if args.open {
        open_page(&directory)?;
        return Ok(OK);
    }
    match args.format {
        Format::Text => print(&requested_text(args, &report, &directory))?,
        Format::Json => {
            print(&(json::to_string(&report).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?
        }
        Format::Html => print(&flight::page(&report))?,
    }
    Ok(OK)
}

/// The requested part of a report.
fn requested_text(args: &ReportArgs, report: &Report, directory: &Path) -> String {
    match &args.section {
        Some(name) => flight::section(report, name),
        None if args.full => flight::text(report),
        None => brief(report, directory),
    }
}

/// A summary of a flight, with the paths of the page and the log.
#[must_use]
fn brief(report: &Report, directory: &Path) -> String {
    let page = Some(directory.join("report.html")).filter(|page| page.is_file());
    let log = log_files(directory).into_iter().next();
    let [page, log] = [page, log].map(|path| path.map(|path| path.display().to_string()));
    brief::render(report, &Left { page, log })
}

/// What `fly` prints at the end: the summary and the RESULT line.
#[must_use]
pub fn ended(report: &Report, directory: &Path) -> String {
    brief(report, directory) + &flight::result_line(report, &directory.display().to_string()) + "\n"
}

/// Marks the last report of a recorder that died, with the time of death.
fn abandoned(report: &mut Report, directory: &Path) {
    if !report.run.in_flight {
        return;
    }
    let last = fs::metadata(directory.join("report.json")).and_then(|file| file.modified());
    let at = last.map_or_else(|_| String::new(), |at| format!(" at {}", utc(at)));
    let ending = format!("the recorder of this flight died{at}");
    break_off(report, FlightStatus::Aborted, ending);
}

/// Reads the report in a run directory.
pub fn read(directory: &Path) -> Result<Report, Failure> {
    let path = directory.join("report.json");
    if !path.exists() {
        return Err(Failure::usage(format!("{} holds no report", directory.display())).help(
            "the first report is written after one second of flight; if the recorder died earlier, \
                 `ironbird export` exports what it had logged",
        ));
    }
    Report::read(&path)
}

/// Compares two flights, or two groups of flights.
fn diff(args: &DiffArgs) -> Result<u8, Failure> {
    let (a, b) = groups(args)?;
    let found = |runs: &[PathBuf]| -> Result<Vec<PathBuf>, Failure> {
        runs.iter()
            .map(|run| find(run, args.out.as_deref()))
            .collect()
    };
    let (a, b) = (found(a)?, found(b)?);
    if let Some(twice) = twice(&a, &b) {
        return Err(
            Failure::usage(format!("{} is named twice", twice.display()))
                .help("a flight cannot be compared with itself: name different flights"),
        );
    }
    let flown = |runs: &[PathBuf]| {
        runs.iter()
            .map(|run| ended_flight(run))
            .collect::<Result<Vec<_>, Failure>>()
    };
    let diff = compare(&flown(&a)?, &flown(&b)?);
    match args.format {
        DiffFormat::Text => print(&diff::render(&diff))?,
        DiffFormat::Json => {
            print(&(json::to_string(&diff).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?
        }
    }
    Ok(OK)
}

/// The two groups on the command line: `A B`, or `A1 A2 .. -- B1 B2 ..`.
fn groups(args: &DiffArgs) -> Result<(&[PathBuf], &[PathBuf]), Failure> {
    match (&args.a[..], &args.b[..]) {
        ([a, b], []) => Ok((std::slice::from_ref(a), std::slice::from_ref(b))),
        (some, []) => Err(Failure::usage(match some.len() {
            1 => "only one flight given; two flights or two groups are compared".to_owned(),
            several => format!(
                "{several} flights without `--`: it is not clear which belong to A and which to B"
            ),
        })
        .help("ironbird report diff A B, or ironbird report diff A1 A2 A3 -- B1 B2 B3")),
        (a, b) => match b
            .iter()
            .find(|run| run.as_os_str().as_encoded_bytes().starts_with(b"-"))
        {
            Some(flag) => Err(Failure::usage(format!(
                "{}: only flights may follow `--`, no flags",
                flag.display()
            ))
            .help("ironbird report diff --format json A1 A2 A3 -- B1 B2 B3")),
            None => Ok((a, b)),
        },
    }
}

/// A flight that is named twice, possibly by different paths.
fn twice<'a>(a: &'a [PathBuf], b: &'a [PathBuf]) -> Option<&'a Path> {
    let mut seen = BTreeSet::new();
    a.iter()
        .chain(b)
        .find(|run| !seen.insert(run.canonicalize().unwrap_or_else(|_| (*run).clone())))
        .map(PathBuf::as_path)
}

fn ended_flight(directory: &Path) -> Result<Flown, Failure> {
    let report = read(directory)?;
    if report.distributions.is_empty() {
        return Err(Failure::usage(format!(
            "{} has no final report with distributions, so its percentiles cannot be compared",
            directory.display()
        ))
        .help("wait for the end of the flight; a flight whose recorder died, or of an older version, has none"));
    }
    let path = directory.join("run.json");
    let text = read_text("read", &path)?;
    let facts = serde_json::from_str(&text).in_file("read", &path)?;
    Ok(Flown {
        run: directory.display().to_string(),
        report,
        facts,
    })
}
