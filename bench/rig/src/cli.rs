//! The command line.

mod gates;
mod real_time;
mod report;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use controller::Preset;
use toml::Value;

use crate::build::VERSION;
use crate::clean::CleanArgs;
pub use crate::cli::gates::{GateArgs, GateName};
pub use crate::cli::real_time::{LeadArg, PaceArg, RtArgs, RtMode};
pub use crate::cli::report::{DiffArgs, DiffFormat, Format, ReportArgs, ReportCommand};
use crate::doctor::DoctorArgs;
use crate::fault::Fault;
use crate::floor::command::FloorArgs;
use crate::floor::hop::HopArgs;
use crate::manual::{CompletionsArgs, ManArgs};
use crate::runs::RunsArgs;
use crate::settings::Overrides;
use flight_log::TOPICS;

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
    /// Swap parameters of the flying airframe: NAME=VALUE...
    Inject(InjectArgs),
    /// List every parameter of the airframe: unit, range, nominal value, value in force.
    Params(ParamsArgs),
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
}

fn presets() -> clap::builder::PossibleValuesParser {
    Preset::NAMES.into()
}

/// What to fly.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct FlightArgs {
    /// Reference trajectory, or a CSV file of points with the columns t,x,y,z,yaw [default: lissajous].
    #[arg(long, value_parser = values::TrajectoryParser)]
    pub trajectory: Option<String>,
    /// Airframe: paper, crazyflie, x500, or an airframe file [default: paper].
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub airframe: Option<String>,
    /// Set of gains [default: flight].
    #[arg(long, value_parser = presets())]
    pub preset: Option<String>,
    /// Length of the flight, as in 30s or 2m [default: 30s].
    #[arg(long, allow_hyphen_values = true, value_parser = values::duration)]
    pub duration: Option<Duration>,
    /// Settings file (TOML); flags override it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Swap plant parameters at an instant: 'NAME=VALUE[,NAME=VALUE]@8s' or '...@tick8000'; may be repeated. A value
    /// is a number, nominal, or +30% of nominal.
    #[arg(long = "fault", value_name = "FAULT", value_parser = values::fault)]
    pub faults: Vec<Fault>,
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
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(TOPICS))]
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
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
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

impl FlightArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(name) = &self.trajectory {
            set.push(("flight.trajectory", Value::from(name.clone())));
        }
        if let Some(name) = &self.airframe {
            set.push(("flight.airframe", Value::from(name.clone())));
        }
        if let Some(name) = &self.preset {
            set.push(("flight.preset", Value::from(name.clone())));
        }
        if let Some(duration) = self.duration {
            set.push(("flight.duration_s", Value::from(duration.as_secs_f64())));
        }
        if !self.faults.is_empty() {
            set.push(("flight.faults", Value::from(self.faults.iter().map(Fault::to_string).collect::<Vec<_>>())));
        }
        set
    }
}

/// A value as it is typed.
fn name_of(value: impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

impl RecorderArgs {
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
