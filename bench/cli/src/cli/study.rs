//! Flags of the commands that simulate many flights: `compare`, `margin`, `campaign`.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand, ValueEnum};

use crate::cli::values::{self, Shard};
use crate::cli::{DiffFormat, TrajectoryArgs};
use experiments::margin::limits::{BOUNDS, BoundName};
use experiments::margin::target;

/// Built-in tables of `compare`, each with its name.
pub const SUITES: [(&str, &str); 1] = [(
    "robustness",
    include_str!("../../../../docs/robustness.toml"),
)];

/// The laws to fly: every outer law with every inner law and every mixer.
#[derive(Clone, Debug, Args)]
pub struct LawSetArgs {
    /// Law of the outer loop; may be repeated [default: pd]. Every combination of the named laws is flown.
    ///
    /// A law may have a preset and settings of its own, as in adaptive:soft,alpha_1_s=150.
    #[arg(long, value_name = "LAW|FILE[:PRESET,KEY=VALUE]")]
    pub outer: Vec<String>,
    /// Law of the inner loop; may be repeated [default: adaptive].
    #[arg(long, value_name = "LAW|FILE[:PRESET,KEY=VALUE]")]
    pub inner: Vec<String>,
    /// Law of the mixer; may be repeated [default: roll_pitch_first].
    #[arg(long, value_name = "LAW|FILE[:PRESET,KEY=VALUE]")]
    pub mixer: Vec<String>,
}

#[derive(Clone, Debug, Args)]
pub struct CompareArgs {
    #[command(flatten)]
    pub course: TrajectoryArgs,
    #[command(flatten)]
    pub laws: LawSetArgs,
    /// A flight has recovered from a fault when its true position error stays below this [m] [default: 0.05], and its
    /// yaw error below flight.tracking_yaw_error_max_rad.
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = values::limit)]
    pub recovered_below: Option<f64>,
    /// Output format.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the comparison to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
    /// Maximum number of lost flights, else exit code 3 [default: no limit].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::within(0..=u64::MAX))]
    pub max_lost: Option<u64>,
    /// JSON: include the curves of the page.
    #[arg(long)]
    pub traces: bool,
    /// Fly once per row of this file, each a [[row]] with `name` and `faults`, and print Markdown tables. Without
    /// --inner, all built-in inner laws fly.
    #[arg(long, value_name = "FILE.toml", group = "cases", conflicts_with_all = ["faults", "format", "traces"])]
    pub table: Option<PathBuf>,
    /// Fly a built-in table: robustness (`ironbird docs robustness`).
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(SUITES.map(|(name, _)| name)), group = "cases", conflicts_with_all = ["faults", "format", "traces"])]
    pub suite: Option<String>,
    /// Also draw the table to this file.
    #[arg(long, value_name = "FILE.svg", requires = "cases")]
    pub picture: Option<PathBuf>,
    /// Also write the figures of all flights of the table to this file.
    #[arg(long, value_name = "FILE.csv", requires = "cases")]
    pub csv: Option<PathBuf>,
}

#[derive(Clone, Debug, Args)]
pub struct MarginArgs {
    #[command(flatten)]
    pub course: TrajectoryArgs,
    #[command(flatten)]
    pub laws: LawSetArgs,
    /// Another bound for the limits: unnoticed_below_m (0.02), unnoticed_yaw_below_rad (0.02), recovered_below_m
    /// (flight.tracking_error_max_m), recovered_yaw_below_rad (flight.tracking_yaw_error_max_rad), recovery_max_s (5), survival_max_s (20), rate_step_increase_rad_s (1e-4); may be repeated.
    #[arg(long = "gate", value_name = "NAME=MAX", value_parser = bound)]
    pub gates: Vec<(BoundName, f64)>,
    /// Number of instants at which faults begin, spread over one period of the trajectory or over --duration. 1 is a
    /// quick look.
    #[arg(long, value_name = "N", default_value_t = 4, allow_hyphen_values = true, value_parser = values::within(1..=1000_u32))]
    pub phases: u32,
    /// Measure only this: a stage, all stages at once (machine), or the inputs of a topic; may be repeated. With --only,
    /// --gate or --duration, no table is stored for flight reports.
    #[arg(long, value_name = "WHAT", value_parser = PossibleValuesParser::new(target::names()))]
    pub only: Vec<String>,
    /// Longest outage to try.
    #[arg(long, value_name = "DURATION", default_value = "2s", allow_hyphen_values = true, value_parser = values::duration)]
    pub longest: Duration,
    /// Number of parallel jobs [default: one per CPU].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::jobs)]
    pub jobs: Option<usize>,
    /// Directory of the flights whose reports use these margins; the table goes to DIR/margins [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Output format.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the margins to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
}

#[derive(Clone, Debug, Subcommand)]
pub enum CampaignCommand {
    /// Run a campaign, or one shard of it; flights that are already recorded are not repeated.
    #[command(after_help = "\
Example:
  ironbird campaign run examples/mass-and-drag.toml --out campaigns/mass")]
    Run(CampaignRunArgs),
    /// Check a campaign file: number of flights, expected time and size.
    Check(CampaignCheckArgs),
    /// List complete, missing, broken and foreign chunks of a campaign.
    Status(CampaignDirectoryArgs),
    /// Merge all rows of a campaign into one file, merged.parquet.
    Merge(CampaignDirectoryArgs),
    /// Print a campaign's results: success rates, differences between variants, influential factors, worst flights.
    Report(CampaignReportArgs),
    /// Run a campaign's shards on a cluster (Slurm, HyperQueue), retry failed shards, then print the report.
    Submit(CampaignSubmitArgs),
    /// Repeat one flight of a campaign in four processes, with log and report page. A flight with recorded timing or
    /// stage faults is simulated instead, with states and plot.
    Fly(CampaignFlyArgs),
}

#[derive(Clone, Debug, Args)]
pub struct CampaignRunArgs {
    /// The campaign file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Run only shard K of N, counted from 1. K may be `auto`: the task number given by Slurm or HyperQueue.
    #[arg(long, value_name = "K/N", value_parser = values::shard)]
    pub shard: Option<Shard>,
    /// Directory of the rows [default: campaigns/NAME].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Number of parallel jobs [default: one per CPU].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::jobs)]
    pub jobs: Option<usize>,
}

#[derive(Clone, Debug, Args)]
pub struct CampaignCheckArgs {
    /// The campaign file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Number of parallel jobs [default: one per CPU].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::jobs)]
    pub jobs: Option<usize>,
}

#[derive(Clone, Debug, Args)]
pub struct CampaignSubmitArgs {
    /// The campaign file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// What runs the shards.
    #[arg(long, value_enum, value_name = "ENGINE")]
    pub on: Engine,
    /// Number of shards [default: one per row file, at most 1000].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::shards)]
    pub shards: Option<u64>,
    /// Directory of the rows, visible to all nodes [default: campaigns/NAME].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the job script and the submit command, and exit.
    #[arg(long)]
    pub dry_run: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// A Slurm array job (sbatch).
    Slurm,
    /// A HyperQueue task array (hq).
    Hyperqueue,
    /// This machine, like `campaign run`.
    Local,
}

#[derive(Clone, Debug, Args)]
pub struct CampaignDirectoryArgs {
    /// Directory of the rows, as in `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
}

#[derive(Clone, Debug, Args)]
pub struct CampaignReportArgs {
    /// Directory of the rows, as in `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Output format.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the report to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
    /// Least success rate of every arm [%], else exit code 3; without all flights of the campaign it fails, too.
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true, value_parser = values::percent)]
    pub min_success: Option<f64>,
}

#[derive(Clone, Debug, Args)]
pub struct CampaignFlyArgs {
    /// Directory of the rows, as in `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Number of the flight, counted from 0.
    #[arg(value_name = "N", allow_hyphen_values = true, value_parser = values::within(0..=u64::MAX))]
    pub flight: u64,
    /// Variant that flies it [default: the first].
    #[arg(long, value_name = "NAME")]
    pub arm: Option<String>,
    /// Print the complete, commented settings of the flight, and exit.
    #[arg(long)]
    pub print_config: bool,
    /// Directory in which the flight gets its own directory [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Name of the instance.
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
}

fn bound(text: &str) -> Result<(BoundName, f64), String> {
    let known = || BOUNDS.map(|(name, _)| name).join(", ");
    let (name, most) = text
        .split_once('=')
        .ok_or_else(|| format!("write NAME=MAX; names are {}", known()))?;
    let mut bounds = BOUNDS.into_iter();
    let bound = bounds
        .find(|(it, _)| *it == name.trim())
        .ok_or_else(|| format!("no bound has this name; there are {}", known()))?;
    Ok((bound, values::limit(most.trim())?))
}
