//! Flags of `report` and of `report diff`.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand, ValueEnum};
use report::text::SECTION_NAMES;

/// Flags of `report`.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ReportArgs {
    /// What else to do with reports.
    #[command(subcommand)]
    pub command: Option<ReportCommand>,
    /// A flight's directory, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Print everything: every latency, outage, process and gate [default: what matters, in 30 lines].
    #[arg(long, conflicts_with_all = ["section", "format"])]
    pub full: bool,
    /// Print this part of everything.
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(SECTION_NAMES), conflicts_with = "format")]
    pub section: Option<String>,
    /// How to print it.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
    /// Also write the gates and the three words to this file, as JUnit XML for a CI server.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Open the flight's page in a browser instead: the one that BROWSER names, or the system's.
    #[arg(long, conflicts_with_all = ["full", "section", "format"])]
    pub open: bool,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// What else to do with reports.
#[derive(Clone, Debug, Subcommand)]
pub enum ReportCommand {
    /// Compare flights: two by their numbers, groups of three and more by what they differ in.
    Diff(DiffArgs),
}

/// Flags of `report diff`.
#[derive(Clone, Debug, Args)]
pub struct DiffArgs {
    /// Two flights, A and B, by directory or `latest`; or the flights of group A, with those of B after `--`.
    #[arg(value_name = "A", required = true)]
    pub a: Vec<PathBuf>,
    /// The flights of group B; ratios are B over A.
    #[arg(value_name = "B", last = true)]
    pub b: Vec<PathBuf>,
    /// How to print the comparison.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Directory in which flights are looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// How to print a report.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// For programs.
    Json,
    /// For browsers: the page that every flight leaves as report.html.
    Html,
}

/// How to print a comparison.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum DiffFormat {
    /// For people.
    Text,
    /// For programs.
    Json,
}
