//! `ironbird report`: prints the report of a flight, also while it is running; `report diff` compares flights.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::browser::open_page;
use crate::cli::{DiffArgs, DiffFormat, Format, ReportArgs, ReportCommand};
use analysis::diff::{ComparedRun, compare};
use analysis::gates::break_off;
use analysis::json::print_json;
use analysis::report_file::RunFacts;
use analysis::schema::{AcceptanceResult, FlightStatus, Gate, Report};
use errors::output::{print, say};
use errors::{Failure, OK, check_outputs, write_text};
use experiments::margin::table::look_again;
use flight_log::wall_time::utc;
use recorder::hlog;
use recorder::run_directory::{FACTS, LATEST, find, log_files};
use render::document::Document;
use render::{brief, diff, flight, junit, page, sentences};
use serde::Serialize;

pub fn show(args: &ReportArgs) -> Result<u8, Failure> {
    if let Some(ReportCommand::Diff(args)) = &args.command {
        return diff(args);
    }
    check_outputs(&[("--junit", args.junit.as_deref())])?;
    let directory = find(&args.run, args.out.as_deref())?;
    // Print the real name: `latest` will point to another flight later.
    let directory = match fs::read_link(&directory) {
        Ok(name) => directory.with_file_name(name),
        Err(_) => directory,
    };
    let mut report = read(&directory)?;
    if report.run.in_flight && !hlog::lives(&directory) {
        // The recorder may have written the final report meanwhile.
        report = read(&directory)?;
        if report.run.in_flight {
            abandon(&mut report, &directory);
        }
    }
    look_again(&mut report, &directory);
    if let Some(path) = &args.junit {
        junit::write(&report, path)?;
    }
    match (args.format, &args.section) {
        _ if args.open => open_page(&directory)?,
        (Format::Text, Some(name)) => print(&flight::section(&report, name))?,
        (Format::Text, None) if args.full => print(&flight::text(&report))?,
        (Format::Text, None) => print(&brief(&report, &directory))?,
        (Format::Json, _) => print_json(&report)?,
        (Format::Html, _) => print(&page::render(&report))?,
    }
    Ok(OK)
}

/// Prints a document, or the values in it as JSON, and writes it as a page, too.
pub fn publish(
    document: &Document,
    values: &impl Serialize,
    format: DiffFormat,
    page: Option<&Path>,
) -> Result<(), Failure> {
    match format {
        DiffFormat::Text => print(&document.text()),
        DiffFormat::Json => print_json(values),
    }?;
    if let Some(path) = page {
        write_text(path, &document.html())?;
        say(&format!("written: {}\n", path.display()));
    }
    Ok(())
}

/// The exit code of a command with these gates; those that do not hold are named.
pub fn exit_code(gates: impl IntoIterator<Item = Gate>) -> u8 {
    let result = AcceptanceResult::of(gates.into_iter().collect());
    let failed = result.gates.iter().filter(|gate| !gate.held);
    failed.for_each(|gate| say(&format!("{}\n", sentences::gate(gate))));
    result.exit_code
}

/// A summary of a flight, with the paths of the page and the log.
fn brief(report: &Report, directory: &Path) -> String {
    let page = Some(directory.join("report.html")).filter(|page| page.is_file());
    let log = log_files(directory).into_iter().next();
    let [page, log] = [page, log].map(|path| path.map(|path| path.display().to_string()));
    let path = |run: &Path| run.canonicalize().ok();
    let latest = find(Path::new(LATEST), None).ok();
    let is_latest = latest.is_some_and(|latest| path(&latest) == path(directory));
    let run = (!is_latest).then(|| directory.display().to_string());
    brief::render(report, &brief::Left { page, log, run })
}

/// What `fly` prints at the end: the summary and the RESULT line.
#[must_use]
pub fn ended(report: &Report, directory: &Path) -> String {
    brief(report, directory) + &flight::result_line(report, &directory.display().to_string()) + "\n"
}

/// Marks the last report of a recorder that died, or whose final report the disk did not take, with its time.
pub fn abandon(report: &mut Report, directory: &Path) {
    let written = fs::metadata(directory.join("report.json")).and_then(|file| file.modified());
    let at = written.map_or_else(|_| String::new(), |at| format!(" at {}", utc(at)));
    let ending = format!("no final report: the recorder died, or the disk was full{at}");
    break_off(report, FlightStatus::Aborted, ending, "");
}

pub fn read(directory: &Path) -> Result<Report, Failure> {
    let path = directory.join("report.json");
    if path.exists() {
        return Report::read(&path);
    }
    Err(Failure::usage(format!("{} holds no report", directory.display())).help(
        "the first report is written after one second of flight; if the recorder died earlier, `ironbird export` exports \
         what it had logged",
    ))
}

fn diff(args: &DiffArgs) -> Result<u8, Failure> {
    let (a, b) = groups(args)?;
    let directories = |runs: &[PathBuf]| -> Result<Vec<PathBuf>, Failure> {
        let runs = runs.iter().map(|run| find(run, args.out.as_deref()));
        runs.collect()
    };
    let (a, b) = (directories(a)?, directories(b)?);
    let mut seen = BTreeSet::new();
    let mut all = a.iter().chain(&b);
    // A flight may be named twice by different paths.
    let is_known =
        |run: &&PathBuf| !seen.insert(run.canonicalize().unwrap_or_else(|_| (*run).clone()));
    if let Some(twice) = all.find(is_known) {
        let what = format!("{} is named twice", twice.display());
        return Err(Failure::usage(what)
            .help("a flight cannot be compared with itself: name different flights (`latest` is a link to the newest one)"));
    }
    let flown = |runs: Vec<PathBuf>| -> Result<Vec<ComparedRun>, Failure> {
        runs.iter().map(|run| ended_flight(run)).collect()
    };
    let diff = compare(&flown(a)?, &flown(b)?);
    match args.format {
        DiffFormat::Text => print(&diff::render(&diff))?,
        DiffFormat::Json => print_json(&diff)?,
    }
    Ok(OK)
}

/// The two groups on the command line: `A B`, or `A1 A2 .. -- B1 B2 ..`.
fn groups(args: &DiffArgs) -> Result<(&[PathBuf], &[PathBuf]), Failure> {
    let is_flag = |run: &&PathBuf| run.as_os_str().as_encoded_bytes().starts_with(b"-");
    let (what, help) = match (&args.a[..], &args.b[..]) {
        ([a, b], []) => return Ok((std::slice::from_ref(a), std::slice::from_ref(b))),
        (runs, []) => (
            match runs.len() {
                1 => "only one flight given; two flights or two groups are compared".to_owned(),
                several => format!(
                    "{several} flights without `--`: it is not clear which belong to A and which to B"
                ),
            },
            "ironbird report diff A B, or ironbird report diff A1 A2 A3 -- B1 B2 B3",
        ),
        (a, b) => match b.iter().find(is_flag) {
            None => return Ok((a, b)),
            Some(flag) => (
                format!("{}: only flights may follow `--`, no flags", flag.display()),
                "ironbird report diff --format json A1 A2 A3 -- B1 B2 B3",
            ),
        },
    };
    Err(Failure::usage(what).help(help))
}

fn ended_flight(directory: &Path) -> Result<ComparedRun, Failure> {
    let report = read(directory)?;
    if report.distributions.is_empty() {
        return Err(Failure::usage(format!(
            "{} has no final report with distributions, so its percentiles cannot be compared",
            directory.display()
        ))
        .help("wait for the end of the flight; a flight whose recorder died has none"));
    }
    Ok(ComparedRun {
        run: directory.display().to_string(),
        report,
        facts: RunFacts::read(&directory.join(FACTS))?,
    })
}
