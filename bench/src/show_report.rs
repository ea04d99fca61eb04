//! `ironbird report`: the report of a flight, also of one still in the air.

use std::path::{Path, PathBuf};

use crate::cli::{Format, ReportArgs};
use crate::failure::{Failure, OK};
use crate::output::print;
use crate::record::report::Report;
use crate::record::text;
use crate::settings::Settings;

/// Prints a report.
///
/// # Errors
/// Usage, where there is no such flight or it has no report yet.
pub fn show(args: &ReportArgs) -> Result<u8, Failure> {
    let directory = find(&args.run, args.out.as_deref())?;
    let path = directory.join("report.json");
    if !path.exists() {
        return Err(Failure::usage(format!("{} holds no report", directory.display()))
            .help("a flight has its first report after one second in the air"));
    }
    let report = Report::read(&path)?;
    match args.format {
        Format::Text => print(&text::render(&report))?,
        Format::Json => {
            let json = serde_json::to_string_pretty(&report).map_err(|e| Failure::failed(e.to_string()))?;
            print(&(json + "\n"))?;
        }
    }
    Ok(OK)
}

fn find(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    let out = match out {
        Some(out) => out.to_owned(),
        None => PathBuf::from(Settings::resolve(None, &Vec::new())?.recorder.out),
    };
    let candidates = [run.to_owned(), out.join(run)];
    candidates.iter().find(|path| path.is_dir()).cloned().ok_or_else(|| {
        Failure::usage(format!("no flight at {} or {}", candidates[0].display(), candidates[1].display()))
            .help("name a flight's directory, or `latest`; --out DIR says where flights were recorded")
    })
}
