//! Flags of `campaign`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use crate::cli::{DiffFormat, values};

/// What to do with a campaign.
#[derive(Clone, Debug, Subcommand)]
pub enum CampaignCommand {
    /// Fly a campaign, or a shard of it; what is there already is not flown again.
    Run(CampaignRunArgs),
    /// Say how many flights a file means, how long they take here, and how many bytes; or what is wrong with it.
    Check(CampaignCheckArgs),
    /// Say which flights of a campaign are there, missing, broken or foreign.
    Status(CampaignDirectoryArgs),
    /// Put all rows of a campaign into one file, merged.parquet.
    Merge(CampaignDirectoryArgs),
    /// Say what a campaign has shown: success, differences of arms, what matters, the worst flights.
    Report(CampaignReportArgs),
    /// Have an engine fly the shards of a campaign, and again those that it lost; then report.
    Submit(CampaignSubmitArgs),
    /// Fly one flight of a campaign again in four processes, with its log and its page; one with a recorded timing or
    /// faults of stages in this process, with its states and its picture.
    Fly(CampaignFlyArgs),
}

/// Flags of `campaign run`.
#[derive(Clone, Debug, Args)]
pub struct CampaignRunArgs {
    /// The campaign's file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Fly a part of it: the K-th of N, from 1 on. K may be `auto`, the number of a job's task in Slurm or HyperQueue.
    #[arg(long, value_name = "K/N", value_parser = values::shard)]
    pub shard: Option<Shard>,
    /// Directory of the rows [default: campaigns/NAME].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Flights at once [default: one on each processor].
    #[arg(long, value_name = "N", value_parser = values::jobs)]
    pub jobs: Option<usize>,
    /// Stop as soon as this holds: 'width(success) < 0.01', of the interval of the success rate, of each arm.
    #[arg(long, value_name = "CONDITION", value_parser = values::until)]
    pub until: Option<f64>,
}

/// Flags of `campaign check`.
#[derive(Clone, Debug, Args)]
pub struct CampaignCheckArgs {
    /// The campaign's file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Flights at once [default: one on each processor].
    #[arg(long, value_name = "N", value_parser = values::jobs)]
    pub jobs: Option<usize>,
}

/// Flags of `campaign submit`.
#[derive(Clone, Debug, Args)]
pub struct CampaignSubmitArgs {
    /// The campaign's file.
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// What runs the shards.
    #[arg(long, value_enum, value_name = "ENGINE")]
    pub on: Engine,
    /// Parts of the campaign [default: one for each file of rows, 1000 at the most].
    #[arg(long, value_name = "N", value_parser = values::shards)]
    pub shards: Option<u64>,
    /// Directory of the rows, which all nodes must see [default: campaigns/NAME].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the script and the command that would submit it, and end.
    #[arg(long)]
    pub dry_run: bool,
}

/// What runs the shards of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// An array job of Slurm (sbatch).
    Slurm,
    /// A task array of HyperQueue (hq).
    Hyperqueue,
    /// This machine, as `campaign run`.
    Local,
}

/// A part of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Its number, from 1; none where the task that this process is of says it.
    pub number: Option<u64>,
    /// How many there are.
    pub of: u64,
}

/// A campaign's directory.
#[derive(Clone, Debug, Args)]
pub struct CampaignDirectoryArgs {
    /// Directory of the rows, as of `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
}

/// Flags of `campaign report`.
#[derive(Clone, Debug, Args)]
pub struct CampaignReportArgs {
    /// Directory of the rows, as of `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// How to print the report.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the report to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
    /// Give exact intervals of success (Clopper and Pearson) instead of Wilson's.
    #[arg(long)]
    pub exact: bool,
    /// Fly this share of the flights again, and hold them against their rows: exit code 3 where one differs.
    #[arg(long, value_name = "SHARE", value_parser = values::share)]
    pub audit: Option<f64>,
    /// Flights at once of an audit [default: one on each processor].
    #[arg(long, value_name = "N", value_parser = values::jobs, requires = "audit")]
    pub jobs: Option<usize>,
}

/// Flags of `campaign fly`.
#[derive(Clone, Debug, Args)]
pub struct CampaignFlyArgs {
    /// Directory of the rows, as of `campaign run --out`.
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Number of the flight, from 0.
    #[arg(value_name = "N")]
    pub flight: u64,
    /// The arm that flies it [default: the first].
    #[arg(long, value_name = "NAME")]
    pub arm: Option<String>,
    /// Fly in real time; a flight is in lockstep otherwise, and then its outputs must be those of its row.
    #[arg(long)]
    pub live: bool,
    /// Print the full commented settings of the flight, and end.
    #[arg(long)]
    pub print_config: bool,
    /// Directory in which the flight gets one of its own [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Instance name.
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
}
