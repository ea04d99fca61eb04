//! `ironbird report diff`: reads two flights and prints how they compare.

use std::path::Path;

use failure::{Failure, InFile as _, OK};
use report::diff::{Flown, compare, text};
use report::json;

use crate::cli::{DiffArgs, DiffFormat};
use crate::output::print;
use crate::run_directory::find;
use crate::show_report::read;

/// Compares.
///
/// # Errors
/// Usage, where a flight or its report is not there, or is not at its end.
pub fn diff(args: &DiffArgs) -> Result<u8, Failure> {
    let [a, b] = [&args.a, &args.b].map(|run| flown(&find(run, args.out.as_deref())?));
    let diff = compare(&a?, &b?);
    match args.format {
        DiffFormat::Text => print(&text::render(&diff))?,
        DiffFormat::Json => print(&(json::to_string(&diff).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
    }
    Ok(OK)
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
    let text = std::fs::read_to_string(&path).in_file("read", &path)?;
    let facts = serde_json::from_str(&text).in_file("read", &path)?;
    Ok(Flown { run: directory.display().to_string(), report, facts })
}
