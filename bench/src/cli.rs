//! The command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use controller::{Preset, Trajectory};
use toml::Value;

use crate::fault::{Fault, parse_change};
use crate::settings::Overrides;

/// A real-time rig for quadrotor flight control loops.
///
/// Flies an adaptive controller in four real-time processes over shared memory, swaps parameters of the airframe
/// in flight, and reports how late every step was.
#[derive(Debug, Parser)]
#[command(name = "ironbird", version, max_term_width = 110)]
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
    /// Swap parameters of the flying airframe: NAME=VALUE...
    Inject(InjectArgs),
    /// List every parameter of the airframe: unit, range, nominal value, value in force.
    Params(ParamsArgs),
    /// Show the report of a flight, also of one still in the air.
    Report(ReportArgs),
    /// Fly the same laws in one process, in simulated time.
    Simulate(SimulateArgs),
    /// Remove what killed processes left in shared memory.
    Clean,
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
}

fn trajectories() -> clap::builder::PossibleValuesParser {
    Trajectory::NAMES.into()
}

fn presets() -> clap::builder::PossibleValuesParser {
    Preset::NAMES.into()
}

/// What to fly.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct FlightArgs {
    /// Reference trajectory [default: lissajous].
    #[arg(long, value_parser = trajectories())]
    pub trajectory: Option<String>,
    /// Set of gains [default: flight].
    #[arg(long, value_parser = presets())]
    pub preset: Option<String>,
    /// Length of the flight, as in 30s or 2m [default: 30s].
    #[arg(long, value_parser = humantime::parse_duration)]
    pub duration: Option<Duration>,
    /// Settings file (TOML); flags go before it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Swap plant parameters at an instant: 'NAME=VALUE[,NAME=VALUE]@8s' or '...@tick8000'; may be repeated.
    #[arg(long = "fault", value_name = "FAULT", value_parser = |text: &str| text.parse::<Fault>())]
    pub faults: Vec<Fault>,
}

/// How to run it in real time.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Real time")]
pub struct RtArgs {
    /// Whether to insist on real time [default: prefer].
    #[arg(long, value_enum)]
    pub rt: Option<RtMode>,
    /// What moves the ticks of the processes on [default: realtime].
    #[arg(long, value_enum)]
    pub pace: Option<PaceArg>,
    /// Processor of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N")]
    pub cpu: Option<u16>,
    /// Name of the instance; several fly side by side.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Whether to insist on real time.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RtMode {
    /// End with exit code 4 when something is refused.
    Require,
    /// Fly with what is granted, and say what was not.
    Prefer,
    /// Ask for nothing.
    Off,
}

/// Where to record, and which gates to pass.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Record")]
pub struct RecorderArgs {
    /// Directory in which the flight gets one of its own [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Also write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    /// A row of the states every N ticks [default: 50].
    #[arg(long, value_name = "N")]
    pub every: Option<u32>,
    /// Gate: end with exit code 3 when more deadlines per million ticks were missed.
    #[arg(long, value_name = "PPM")]
    pub max_miss_rate: Option<f64>,
    /// Gate: end with exit code 3 when the 99.9th percentile of the loop is above.
    #[arg(long, value_name = "US")]
    pub max_loop_p999: Option<f64>,
    /// Gate: end with exit code 3 when this does not hold; may be repeated.
    #[arg(long = "gate", value_enum, value_name = "GATE")]
    pub gates: Vec<GateName>,
}

/// A gate that is passed or not, without a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GateName {
    /// No unexplained violation of the theorem, and estimates that move as predicted.
    Theorem,
}

fn gate_overrides(gates: &[GateName]) -> Overrides {
    gates
        .iter()
        .map(|gate| match gate {
            GateName::Theorem => ("recorder.gate_theorem", Value::from(true)),
        })
        .collect()
}

/// What moves the ticks on.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PaceArg {
    /// The clock: a tick a millisecond, whoever is ready for it.
    Realtime,
    /// The chain itself: the next tick begins when the rotor command has arrived; not real-time.
    Lockstep,
}

/// Flags of `fly`.
#[derive(Clone, Debug, Args)]
pub struct FlyArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub flight: FlightArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub rt: RtArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub recorder: RecorderArgs,
    /// Print the full commented settings that would be flown, and end.
    #[arg(long)]
    pub print_config: bool,
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
    #[arg(long, value_name = "N")]
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
        set.extend(gate_overrides(&self.gates));
        set
    }
}

/// Flags of `inject`.
#[derive(Clone, Debug, Args)]
pub struct InjectArgs {
    /// New values, all applied at one tick: NAME=VALUE...
    #[arg(required = true, value_name = "NAME=VALUE")]
    pub changes: Vec<String>,
    /// Apply at this tick of the flight.
    #[arg(long, value_name = "N", conflicts_with = "after")]
    pub at_tick: Option<u64>,
    /// Apply this much flight time later, as in 500ms.
    #[arg(long = "in", value_name = "TIME", value_parser = humantime::parse_duration)]
    pub after: Option<Duration>,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Flags of `params`.
#[derive(Clone, Debug, Args)]
pub struct ParamsArgs {
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `report`.
#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// A flight's directory, or `latest`.
    #[arg(value_name = "RUN_DIR", default_value = "latest")]
    pub run: PathBuf,
    /// How to print it.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
    /// Directory in which `latest` is looked up [default: runs].
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
}

impl FlightArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(name) = &self.trajectory {
            set.push(("flight.trajectory", Value::from(name.clone())));
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

impl RtArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(mode) = self.rt {
            set.push(("rt.mode", Value::from(name_of(mode))));
        }
        if let Some(pace) = self.pace {
            set.push(("flight.pace", Value::from(name_of(pace))));
        }
        if let Some(cpu) = self.cpu {
            set.push(("rt.cpu", Value::from(i64::from(cpu))));
        }
        set
    }
}

impl RecorderArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(out) = &self.out {
            set.push(("recorder.out", Value::from(out.to_string_lossy().into_owned())));
        }
        if let Some(every) = self.every {
            set.push(("recorder.states_every_ticks", Value::from(i64::from(every))));
        }
        if let Some(ppm) = self.max_miss_rate {
            set.push(("recorder.max_miss_rate_ppm", Value::from(ppm)));
        }
        if let Some(us) = self.max_loop_p999 {
            set.push(("recorder.max_loop_p999_us", Value::from(us)));
        }
        set.extend(gate_overrides(&self.gates));
        set
    }
}

impl InjectArgs {
    /// The changes, read and checked.
    ///
    /// # Errors
    /// As [`parse_change`].
    pub fn parsed(&self) -> Result<Vec<(shared::parameters::Parameter, f64)>, crate::fault::FaultError> {
        self.changes.iter().flat_map(|text| text.split(',')).map(parse_change).collect()
    }
}
