//! `ironbird report`: prints the report of a flight, even of one in the air.

use std::fs;
use std::path::Path;

use crate::cli::{Format, ReportArgs, ReportCommand};
use crate::margin::table::look_again;
use crate::open_page::open_page;
use crate::output::print;
use crate::record::hlog;
use crate::run_directory::{find, log_files};
use crate::wall_time::utc;
use failure::{Failure, OK, check_writable};
use report::page;
use report::schema::Report;
use report::status::FlightStatus;
use report::text::brief::Left;
use report::verdict::break_off;
use report::{json, junit, text};

/// Prints a report, or a comparison of two.
///
/// # Errors
/// Usage, where there is no such flight or it has no report yet.
pub fn show(args: &ReportArgs) -> Result<u8, Failure> {
    if let Some(ReportCommand::Diff(args)) = &args.command {
        return crate::report_diff::diff(args);
    }
    check_writable("--junit", args.junit.as_deref())?;
    let found = find(&args.run, args.out.as_deref())?;
    // `latest` leads elsewhere tomorrow.
    let directory = fs::read_link(&found).map_or_else(|_| found.clone(), |name| found.with_file_name(name));
    let mut report = read(&directory)?;
    if report.run.in_flight && !hlog::lives(&directory) {
        // It may have said its last word meanwhile.
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
        Format::Text => print(&shown(args, &report, &directory))?,
        Format::Json => print(&(json::to_string(&report).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
        Format::Html => print(&page::render(&report))?,
    }
    Ok(OK)
}

/// As much of a report as was asked for.
fn shown(args: &ReportArgs, report: &Report, directory: &Path) -> String {
    match &args.section {
        Some(name) => text::section(report, name),
        None if args.full => text::render(report),
        None => brief(report, directory),
    }
}

/// What matters of a flight, with where the rest is.
#[must_use]
fn brief(report: &Report, directory: &Path) -> String {
    let page = Some(directory.join("report.html")).filter(|page| page.is_file());
    let log = log_files(directory).into_iter().next();
    let [page, log] = [page, log].map(|path| path.map(|path| path.display().to_string()));
    text::brief::render(report, &Left { page, log })
}

/// What a flight ends with: what matters of it, and the line for programs.
#[must_use]
pub fn ended(report: &Report, directory: &Path) -> String {
    brief(report, directory) + &text::result_line(report, &directory.display().to_string()) + "\n"
}

/// Puts into the last report of a recorder that is no more that it died, and when.
fn abandoned(report: &mut Report, directory: &Path) {
    if !report.run.in_flight {
        return;
    }
    let last = fs::metadata(directory.join("report.json")).and_then(|file| file.modified());
    let at = last.map_or_else(|_| String::new(), |at| format!(" at {}", utc(at)));
    let ending = format!("the recorder of this flight died{at}");
    break_off(report, FlightStatus::Aborted, ending);
}

/// The report in a flight's directory.
///
/// # Errors
/// Usage, where there is none yet; those of [`Report::read`].
pub fn read(directory: &Path) -> Result<Report, Failure> {
    let path = directory.join("report.json");
    if !path.exists() {
        return Err(Failure::usage(format!("{} holds no report", directory.display())).help(
            "a flight has its first report after one second in the air; where its recorder died before, \
                 `ironbird export` gives what it had logged",
        ));
    }
    Report::read(&path)
}
