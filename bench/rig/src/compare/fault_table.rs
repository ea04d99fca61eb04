//! `ironbird compare --table`: a comparison for each row of a file, as Markdown.

use std::path::Path;

use report::render::comparison;
use serde::Deserialize;
use toml::Value;

use super::{Plan, flown};
use crate::cli::CompareArgs;
use crate::settings::Overrides;
use errors::{Failure, read_text};

/// Rows at the most: nobody reads more.
const ROWS_MAX: usize = 50;

/// What a file of rows holds.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    row: Vec<RowOfFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RowOfFile {
    name: String,
    /// The same as `--fault` has it.
    faults: Vec<String>,
}

pub(super) fn tables(
    args: &CompareArgs,
    combinations: &[Overrides],
    path: &Path,
) -> Result<String, Failure> {
    let rows = read(path)?;
    let plan = |row: &RowOfFile| {
        let faults: Vec<Value> = row
            .faults
            .iter()
            .map(|fault| Value::from(fault.as_str()))
            .collect();
        let overrides = [
            args.course.overrides(),
            vec![("flight.faults", Value::from(faults))],
        ]
        .concat();
        Plan::new(args, combinations, &overrides).map_err(|failure| {
            failure.append(&format!(" (row `{}` of {})", row.name, path.display()))
        })
    };
    let plans: Vec<Plan> = rows.iter().map(plan).collect::<Result<_, _>>()?;
    let comparisons = flown(&plans)?;
    let names = rows.into_iter().map(|row| row.name);
    Ok(comparison::tables(
        &names.zip(comparisons).collect::<Vec<_>>(),
    ))
}

fn read(path: &Path) -> Result<Vec<RowOfFile>, Failure> {
    const HELP: &str =
        "each row reads: [[row]], name = \"heavier\", faults = [\"mass_kg=+30%@8s\"]";
    let refused =
        |what: String| Failure::usage(format!("--table {}: {what}", path.display())).help(HELP);
    let text = read_text("read the table", path)
        .map_err(|failure| failure.or_code(errors::USAGE).help(HELP))?;
    let File { row: rows } =
        toml::from_str(&text).map_err(|e| refused(e.to_string().trim_end().replace('\n', " ")))?;
    match rows.len() {
        0 => return Err(refused("it has no row".into())),
        1..=ROWS_MAX => {}
        more => {
            return Err(refused(format!(
                "it has {more} rows: allowed are {ROWS_MAX}"
            )));
        }
    }
    if let Some((_, twice)) = rows
        .iter()
        .enumerate()
        .find(|(i, row)| rows[..*i].iter().any(|it| it.name == row.name))
    {
        return Err(refused(format!("two rows have the name `{}`", twice.name)));
    }
    Ok(rows)
}
