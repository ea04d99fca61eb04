//! `ironbird report`: the report of a flight, also of one still in the air.

use std::path::Path;

use crate::cli::{Format, ReportArgs, ReportCommand};
use crate::output::print;
use crate::run_directory::find;
use failure::{Failure, OK};
use report::page;
use report::schema::Report;
use report::{json, text};

/// Prints a report, or a comparison of two.
///
/// # Errors
/// Usage, where there is no such flight or it has no report yet.
pub fn show(args: &ReportArgs) -> Result<u8, Failure> {
    if let Some(ReportCommand::Diff(args)) = &args.command {
        return crate::report_diff::diff(args);
    }
    let report = read(&find(&args.run, args.out.as_deref())?)?;
    match args.format {
        Format::Text => print(&text::render(&report))?,
        Format::Json => print(&(json::to_string(&report).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
        Format::Html => print(&page::render(&report))?,
    }
    Ok(OK)
}

/// The report in a flight's directory.
///
/// # Errors
/// Usage, where there is none yet; those of [`Report::read`].
pub fn read(directory: &Path) -> Result<Report, Failure> {
    let path = directory.join("report.json");
    if !path.exists() {
        return Err(Failure::usage(format!("{} holds no report", directory.display()))
            .help("a flight has its first report after one second in the air"));
    }
    Report::read(&path)
}
