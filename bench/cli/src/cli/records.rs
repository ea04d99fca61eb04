//! Flags of the commands for recorded flights: `report`, `export`, `replay`, `runs`.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand, ValueEnum};
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use render::flight::section_names;

use crate::cli::values;
use crate::table_file::TableFormat;
use flight_log::topics;

#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct ReportArgs {
    #[command(subcommand)]
    pub command: Option<ReportCommand>,
    /// A flight's directory, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Print every section [default: a summary of 30 lines].
    #[arg(long, conflicts_with_all = ["section", "format"])]
    pub full: bool,
    /// Print only this section of the full report.
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(section_names()), conflicts_with = "format")]
    pub section: Option<String>,
    /// Output format.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
    /// Write the acceptance results to FILE as JUnit XML.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Open the report page in a browser instead: the one named by BROWSER, or the system's.
    #[arg(long, conflicts_with_all = ["full", "section", "format"])]
    pub open: bool,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Clone, Debug, Subcommand)]
pub enum ReportCommand {
    /// Compare two flights by their figures, or two groups of at least three flights by statistical tests.
    Diff(DiffArgs),
}

#[derive(Clone, Debug, Args)]
pub struct DiffArgs {
    /// Two flights, A and B, each a directory or `latest`; or the flights of group A, with group B after `--`.
    #[arg(value_name = "A", required = true)]
    pub a: Vec<PathBuf>,
    /// The flights of group B; ratios are B over A.
    #[arg(value_name = "B", last = true)]
    pub b: Vec<PathBuf>,
    /// Output format.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Directory in which flights are looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Format {
    /// Plain text.
    Text,
    /// The complete report, for programs.
    Json,
    /// The page that every flight leaves as report.html.
    Html,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum DiffFormat {
    /// Plain text.
    Text,
    /// For programs.
    Json,
}

#[derive(Clone, Debug, Args)]
pub struct ExportArgs {
    /// A flight's directory, its flight.mcap, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Write this topic to standard output [default: each topic to its own file].
    #[arg(long, value_parser = PossibleValuesParser::new(topics()))]
    pub topic: Option<String>,
    /// Write one table instead, with a row per state: sensors, ground truth, setpoint, reference, wrench, rotor speeds and
    /// the laws' signals of its tick. What a stage did not publish is empty.
    #[arg(long, conflicts_with = "topic")]
    pub joined: bool,
    /// Output format.
    #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
    pub format: ExportFormat,
    /// Directory of the files [default: `export` in the flight's directory; a Perfetto trace: the flight's directory].
    #[arg(long, value_name = "DIR", conflicts_with = "topic")]
    pub to: Option<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ExportFormat {
    /// One row per message, one column per number.
    Csv,
    /// One JSON object per message, each on its own line; its keys are the columns of the CSV file.
    Json,
    /// Apache Parquet, with the units in the file's metadata.
    Parquet,
    /// MATLAB: one variable per column, with `_` for each `.`; NaN is no value.
    Mat,
    /// A trace for ui.perfetto.dev: one track per stage; missed deadlines, parameter changes and faults as instants.
    Perfetto,
}

impl ExportFormat {
    /// None for a trace, which is no table.
    pub const fn table(self) -> Option<TableFormat> {
        Some(match self {
            Self::Csv => TableFormat::Csv,
            Self::Json => TableFormat::Json,
            Self::Parquet => TableFormat::Parquet,
            Self::Mat => TableFormat::Mat,
            Self::Perfetto => return None,
        })
    }
}

#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// A flight's directory, its flight.mcap, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Compare every output of every stage bit for bit; stop with exit code 3 at the first difference.
    #[arg(long)]
    pub verify: bool,
    /// Compare and count from this tick on; the flight is still replayed from tick 0.
    #[arg(long, value_name = "TICK", default_value_t = 0, allow_hyphen_values = true, value_parser = values::tick)]
    pub from: u64,
    /// New place of the outer law's library; it must be the one that flew. Repeat it for laws of several channels.
    #[arg(long, value_name = "FILE")]
    pub outer: Vec<PathBuf>,
    /// New place of the inner law's library.
    #[arg(long, value_name = "FILE")]
    pub inner: Vec<PathBuf>,
    /// New place of the mixer's library.
    #[arg(long, value_name = "FILE")]
    pub mixer: Vec<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl ReplayArgs {
    /// The libraries of laws that are no longer where the log says.
    pub fn moved(&self) -> Vec<(Role, PathBuf)> {
        let files = [&self.outer, &self.inner, &self.mixer];
        let all = LAW_ROLES.into_iter().zip(files);
        let each = all.flat_map(|(role, files)| files.iter().map(move |it| (role, it.clone())));
        each.collect()
    }
}

#[derive(Clone, Debug, Args)]
pub struct RunsArgs {
    /// Directory of the flights [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long, conflicts_with = "prune")]
    pub json: bool,
    /// Remove old flights, except `latest`, running flights, and directories that ironbird did not create.
    #[arg(long, requires = "which")]
    pub prune: bool,
    /// Keep only the newest N.
    #[arg(long, value_name = "N", requires = "prune", group = "which", allow_hyphen_values = true,
        value_parser = values::within(1..=u32::MAX))]
    pub keep: Option<u32>,
    /// Remove flights that began longer ago, for example 7d or 12h.
    #[arg(long, value_name = "AGE", requires = "prune", group = "which", allow_hyphen_values = true,
        value_parser = values::duration)]
    pub older_than: Option<Duration>,
    /// Show what would be removed, and remove nothing.
    #[arg(long, requires = "prune")]
    pub dry_run: bool,
}
