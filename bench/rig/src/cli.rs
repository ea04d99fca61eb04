//! The command line.

mod campaign;
mod compare;
mod flight;
mod gates;
pub(crate) mod margin;
mod real_time;
mod report;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use toml::Value;

use crate::build::VERSION;
use crate::clean::CleanArgs;
pub use crate::cli::campaign::{
    CampaignCheckArgs, CampaignCommand, CampaignDirectoryArgs, CampaignFlyArgs, CampaignReportArgs, CampaignRunArgs,
    CampaignSubmitArgs, Engine, Shard,
};
pub use crate::cli::compare::CompareArgs;
pub use crate::cli::flight::{CourseArgs, FlightArgs};
pub use crate::cli::gates::{GateArgs, GateName};
pub use crate::cli::margin::{GateLimit, MarginArgs};
pub use crate::cli::real_time::{LeadArg, PaceArg, RtArgs, RtMode};
pub use crate::cli::report::{DiffArgs, DiffFormat, Format, ReportArgs, ReportCommand};
use crate::doctor::DoctorArgs;
use crate::export::topics;
use crate::floor::command::FloorArgs;
use crate::floor::hop::HopArgs;
use crate::fly::burden::BurdenArgs;
use crate::laws::LawsArgs;
use crate::manual::{CompletionsArgs, ManArgs};
use crate::new_law::NewCommand;
use crate::runs::RunsArgs;
use crate::settings::laws::Moved;
use crate::settings::{Overrides, Settings};
use failure::Failure;
use model::role::Role;

mod in_flight;
pub(crate) mod values;
pub use in_flight::{BridgeTo, FoxgloveArgs, InjectArgs, ParamsArgs, WatchArgs};

/// A real-time rig for quadrotor flight control loops.
///
/// Flies an adaptive controller in four real-time processes over shared memory, swaps parameters of the airframe
/// in flight, and reports how late every step was.
#[derive(Debug, Parser)]
#[command(name = "ironbird", version, long_version = VERSION.as_str(), max_term_width = 110)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly: start all processes, show the flight, end them, print the report.
    Fly(FlyArgs),
    /// Watch a flight in the terminal; join and leave at any time.
    Watch(WatchArgs),
    /// Serve a flight to another program's protocol.
    #[command(subcommand)]
    Bridge(BridgeTo),
    /// Have something go wrong in a flight in the air: parameters (NAME=VALUE...), messages, stages, the processor.
    Inject(InjectArgs),
    /// List every parameter of the airframe: unit, range, nominal value, value in force.
    Params(ParamsArgs),
    /// List what else can go wrong: faults of messages and stages, and the fields that can be wrong.
    Faults,
    /// List the laws that can fly; explain one.
    Laws(LawsArgs),
    /// Begin something of your own: a law.
    #[command(subcommand)]
    New(NewCommand),
    /// Show the report of a flight, even of one in the air; or compare flights.
    Report(ReportArgs),
    /// Write the messages of a flight as CSV or JSON, or its stages as a Perfetto trace.
    Export(ExportArgs),
    /// Fly a recorded flight again from its log, and compare.
    Replay(ReplayArgs),
    /// List the flights that were recorded; remove old ones with --prune.
    Runs(RunsArgs),
    /// Fly the same laws in one process, in simulated time.
    Simulate(SimulateArgs),
    /// Fly the same flight with several laws, in simulated time, and put them side by side.
    Compare(CompareArgs),
    /// Measure what a loop bears: the longest outage, lag and share of losses that its flight survives.
    Margin(MarginArgs),
    /// Fly a campaign: many flights with parameters drawn from a file, as rows of a table.
    #[command(subcommand)]
    Campaign(CampaignCommand),
    /// Measure the rig beside the machine's own limits.
    Floor(FloorArgs),
    /// Check whether this machine can fly in real time, and say what to change.
    #[command(
        after_help = "Ends with exit code 0 when the verdict is `hard` or `soft`, with 3 when it is `not real-time here`."
    )]
    Doctor(DoctorArgs),
    /// Remove what killed processes left: shared memory, locks, service files.
    Clean(CleanArgs),
    /// Print the completions of a shell: ironbird completions bash > /etc/bash_completion.d/ironbird
    Completions(CompletionsArgs),
    /// Print the manual page: ironbird man | man -l -
    Man(ManArgs),
    /// Run the airframe alone.
    Plant(RoleArgs),
    /// Run the outer (position) loop alone.
    Outer(RoleArgs),
    /// Run the inner (attitude and rate) loop alone.
    Inner(RoleArgs),
    /// Run the motor mixer alone.
    Mixer(RoleArgs),
    /// Run the recorder alone.
    Record(RecordArgs),
    /// A process of the raw ring that measures the machine.
    #[command(hide = true)]
    RingHop(HopArgs),
    /// A process that keeps the loops' processor busy, for a fault.
    #[command(hide = true)]
    Burden(BurdenArgs),
}

/// Where to record, and which gates to pass.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Record")]
pub struct RecorderArgs {
    /// Directory in which the flight gets one of its own [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Messages to keep in flight.mcap [default: all].
    #[arg(long, value_enum, value_name = "MESSAGES")]
    pub log: Option<LogArg>,
    /// Also write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    /// A row of the states every N ticks [default: 50].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::every)]
    pub every: Option<u32>,
    /// Have the kernel trace the loops' processor: an outage then tells who ran instead.
    #[arg(long)]
    pub trace: bool,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub gates: GateArgs,
}

/// Messages that the flight log keeps.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogArg {
    /// All of them: only such a log can be replayed.
    All,
    /// Those within recorder.log_around_s of a missed deadline, a swap, take-off or landing.
    AroundMisses,
    /// None: there is no flight.mcap.
    Off,
}

/// Flags of `fly`.
#[derive(Clone, Debug, Args)]
pub struct FlyArgs {
    /// Watch the flight in this terminal, as `ironbird watch` does.
    #[arg(long)]
    pub watch: bool,
    /// What to do when a process dies or hangs in flight.
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = OnDeath::End)]
    pub on_death: OnDeath,
    /// Right after the flight, measure each of the machine's floors for this long, for the report [example: 11s].
    #[arg(long, value_name = "DURATION", allow_hyphen_values = true, value_parser = values::duration)]
    pub floor: Option<Duration>,
    /// Also write the gates and the three words to this file, as JUnit XML for a CI server.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Open the flight's page in a browser when it has ended: the one that BROWSER names, or the system's.
    #[arg(long)]
    pub open: bool,
    /// Print the full commented settings that would be flown, and end.
    #[arg(long)]
    pub print_config: bool,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub flight: FlightArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub rt: RtArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub recorder: RecorderArgs,
}

/// What `fly` does when a process of its flight dies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OnDeath {
    /// End the flight, and say who died.
    End,
    /// Have the spare that waits beside each loop take its place, or start it again, at most 5 times in 10 s; one that
    /// hangs for more than 80 ms is killed first. Without a plant the flight ends.
    Restart,
}

impl FlyArgs {
    /// Refuses restarts in lockstep, where nobody can join a flight.
    ///
    /// # Errors
    /// A usage [`Failure`] names the flag.
    pub fn check(&self, settings: &Settings) -> Result<(), Failure> {
        match self.on_death {
            OnDeath::End => Ok(()),
            OnDeath::Restart => real_time::on_the_clock("--on-death restart", settings),
        }
    }
}

/// Flags of a role.
#[derive(Clone, Debug, Args)]
pub struct RoleArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub flight: FlightArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub rt: RtArgs,
    /// End when the process with this number, which must be the parent, ends.
    #[arg(long, hide = true)]
    pub launcher: Option<u32>,
    /// Get ready without a place in the flight, and wait until standard input has a byte; its end is the spare's.
    #[arg(long, hide = true, requires = "launcher")]
    pub spare: bool,
}

/// Flags of the recorder.
#[derive(Clone, Debug, Args)]
pub struct RecordArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub role: RoleArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub recorder: RecorderArgs,
    /// The flight's directory, which exists.
    #[arg(long, hide = true)]
    pub run_dir: Option<PathBuf>,
}

/// Flags of `simulate`.
#[derive(Clone, Debug, Args)]
pub struct SimulateArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub flight: FlightArgs,
    /// Draw the flight into this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Fly with the outages, skipped ticks and stale inputs of this recorded flight: its directory, its log, or latest.
    #[arg(long, value_name = "RUN")]
    pub timing: Option<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR", requires = "timing")]
    pub out: Option<PathBuf>,
    /// Write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    /// A row of the states every N ticks [default: 50].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::every)]
    pub every: Option<u32>,
    /// Gate: end with exit code 3 when this does not hold; may be repeated.
    #[arg(long = "gate", value_enum, value_name = "GATE")]
    pub gates: Vec<GateName>,
}

impl SimulateArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = self.flight.overrides();
        if let Some(every) = self.every {
            set.push(("recorder.states_every_ticks", Value::from(i64::from(every))));
        }
        set.extend(gates::named(&self.gates));
        set
    }
}

/// Flags of `export`.
#[derive(Clone, Debug, Args)]
pub struct ExportArgs {
    /// A flight's directory, its flight.mcap, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Write this topic to standard output [default: every topic to a file].
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(topics()))]
    pub topic: Option<String>,
    /// How to write it.
    #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
    pub format: ExportFormat,
    /// Directory of the files [default: `export` in the flight's directory; a Perfetto trace: the flight's directory].
    #[arg(long, value_name = "DIR", conflicts_with = "topic")]
    pub to: Option<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Flags of `replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// A flight's directory, its flight.mcap, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// Compare every output of every stage bit for bit; end with exit code 3 at the first difference.
    #[arg(long)]
    pub verify: bool,
    /// Compare and count from this tick on; the flight is still flown from tick 0.
    #[arg(long, value_name = "TICK", default_value_t = 0)]
    pub from: u64,
    /// Where the file of the outer law is now; it must be the one that flew.
    #[arg(long, value_name = "FILE")]
    pub outer: Option<PathBuf>,
    /// Where the file of the inner law is now.
    #[arg(long, value_name = "FILE")]
    pub inner: Option<PathBuf>,
    /// Where the file of the mixer is now.
    #[arg(long, value_name = "FILE")]
    pub mixer: Option<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

impl ReplayArgs {
    /// Where the files of laws are now.
    #[must_use]
    pub fn moved(&self) -> Moved {
        let named = [(Role::Outer, &self.outer), (Role::Inner, &self.inner), (Role::Mixer, &self.mixer)];
        named.into_iter().filter_map(|(role, file)| Some((role, file.clone()?))).collect()
    }
}

/// How to write messages.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ExportFormat {
    /// A row per message, a column per number.
    Csv,
    /// An object per message and line.
    Json,
    /// One trace for ui.perfetto.dev: a track per stage, missed deadlines and swaps as instants.
    Perfetto,
}

/// A value as it is typed.
fn name_of(value: impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

impl RecorderArgs {
    /// Refuses flags that only mean something on the clock, where a flight is in lockstep.
    ///
    /// # Errors
    /// A usage [`Failure`] names the flag.
    pub fn check(&self, settings: &Settings) -> Result<(), Failure> {
        if self.trace { real_time::on_the_clock("--trace", settings) } else { Ok(()) }
    }

    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(out) = &self.out {
            set.push(("recorder.out", Value::from(out.to_string_lossy().into_owned())));
        }
        if let Some(log) = self.log {
            set.push(("recorder.log", Value::from(name_of(log))));
        }
        if let Some(every) = self.every {
            set.push(("recorder.states_every_ticks", Value::from(i64::from(every))));
        }
        if self.trace {
            set.push(("recorder.trace", Value::from(true)));
        }
        set.extend(self.gates.overrides());
        set
    }
}
