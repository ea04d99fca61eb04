//! The command line: one struct per command, the settings that its flags override, and what only commands do.
//!
//! Nothing below this module knows clap or the flags: it takes plain values.

pub mod commands;
pub(crate) mod flight;
pub mod fly;
mod interaction;
mod machine;
mod records;
pub mod roles;
pub(crate) mod setting_flags;
mod study;
pub(crate) mod values;

use std::env::args_os;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use toml::Value;

use crate::build::VERSION;
use crate::laws::LawsArgs;
use crate::new_law::NewCommand;
use config::Overrides;
use errors::Failure;

pub use flight::{
    FlightArgs, FlyArgs, GateArgs, GateName, OnDeath, RecordArgs, RecorderArgs, RoleArgs, RtArgs,
    SimulateArgs, TrajectoryArgs,
};
pub use interaction::{
    BridgeTo, FoxgloveArgs, InjectArgs, MavlinkArgs, PageArgs, ParamsArgs, SwitchArgs, WatchArgs,
};
pub use machine::{
    CleanArgs, CompletionsArgs, CpuLoadArgs, DocsArgs, DoctorArgs, FloorArgs, HopArgs, ManArgs,
};
pub use records::{
    DiffArgs, DiffFormat, ExportArgs, ExportFormat, Format, ReplayArgs, ReportArgs, ReportCommand,
    RunsArgs,
};
pub use study::{
    CampaignCheckArgs, CampaignCommand, CampaignDirectoryArgs, CampaignFlyArgs, CampaignReportArgs,
    CampaignRunArgs, CampaignSubmitArgs, CompareArgs, Engine, LawSetArgs, MarginArgs, SUITES,
};
pub use values::Shard;

/// A real-time test rig for quadrotor flight controllers.
///
/// Flies an adaptive controller in four real-time processes over shared memory, changes airframe parameters in flight,
/// and reports how late every step was.
#[derive(Debug, Parser)]
#[command(name = "ironbird", version, long_version = VERSION.as_str(), max_term_width = 110)]
#[command(after_help = "\
Start here:
  ironbird fly                    fly for 30 s in real time and print the report
  ironbird simulate               fly the same flight in one process, faster than real time
  ironbird doctor                 check whether this machine can fly in real time
  ironbird inject rotational_drag_nm_s=0.315
                                  change a parameter of the flight that is running")]
pub struct Cli {
    /// End with the process of this number, which must be the parent.
    #[arg(long, global = true, hide = true)]
    pub launcher: Option<u32>,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly in real time: start all processes, show the flight and print its report.
    #[command(after_help = "\
Examples:
  ironbird fly --duration 60s --trajectory lissajous
  ironbird fly --fault 'rotational_drag_nm_s=+200%@8s'
  ironbird fly --inner ./my_law --max-miss-rate 100")]
    Fly(FlyArgs),
    /// Watch a running flight in the terminal, or on a page in a browser.
    Watch(WatchArgs),
    /// Serve a running flight to another program.
    #[command(subcommand)]
    Bridge(BridgeTo),
    /// Inject faults into a running flight: change parameters, drop or delay messages, stop stages, load the CPU.
    #[command(after_help = "\
Examples:
  ironbird inject rotational_drag_nm_s=0.315
  ironbird inject state.drop=0.1 --for 1s
  ironbird inject inner.stop=20ms --in 500ms")]
    Inject(InjectArgs),
    /// Let another channel with its own laws fly, in a flight with several.
    Switch(SwitchArgs),
    /// List the airframe's parameters: unit, range, nominal and current value.
    Params(ParamsArgs),
    /// List the fault kinds for messages, stages and the CPU.
    Faults,
    /// List the control laws, or explain one.
    Laws(LawsArgs),
    /// Create a control law of your own from a template.
    #[command(subcommand)]
    New(NewCommand),
    /// Print a flight's report, or compare flights.
    #[command(after_help = "\
Examples:
  ironbird report --full
  ironbird report --section latencies
  ironbird report diff A1 A2 A3 -- B1 B2 B3")]
    Report(ReportArgs),
    /// Export a flight's messages as CSV, JSON, Parquet or MAT files, or its stages as a Perfetto trace.
    Export(ExportArgs),
    /// Run a recorded flight again from its log and compare the results.
    #[command(after_help = "\
Example:
  ironbird replay latest --verify")]
    Replay(ReplayArgs),
    /// List the recorded flights; remove old ones with --prune.
    Runs(RunsArgs),
    /// Fly in one process, in simulated time.
    #[command(after_help = "\
Examples:
  ironbird simulate --inner indi --fault 'disturbance_gain_rad_s2=2@8s'
  ironbird simulate --timing latest --plot flight.svg")]
    Simulate(SimulateArgs),
    /// Simulate the same flight with several laws and compare them.
    #[command(after_help = "\
Example:
  ironbird compare --inner adaptive --inner indi --fault 'disturbance_gain_rad_s2=2@8s'")]
    Compare(CompareArgs),
    /// Measure a loop's robustness: the longest outage, delay and message loss it survives.
    #[command(after_help = "\
Example:
  ironbird margin --inner adaptive --inner indi --page margins.html")]
    Margin(MarginArgs),
    /// Run a campaign: many simulated flights with parameters drawn at random.
    #[command(subcommand)]
    Campaign(CampaignCommand),
    /// Compare the rig's timing with the limits of this machine.
    Floor(FloorArgs),
    /// Check whether this machine can fly in real time, and say what to change.
    #[command(
        after_help = "Exit code 0: the verdict is `hard` or `soft`. Exit code 3: it is `not real-time here`."
    )]
    Doctor(DoctorArgs),
    /// Remove what killed processes left behind: shared memory, locks, service files.
    Clean(CleanArgs),
    /// Print a page of the documentation; without PAGE, the folder with all of it and the examples.
    Docs(DocsArgs),
    /// Print shell completions: ironbird completions bash > /etc/bash_completion.d/ironbird
    Completions(CompletionsArgs),
    /// Print the manual page: ironbird man | man -l -
    Man(ManArgs),
    /// Run only the plant (the simulated airframe).
    Plant(RoleArgs),
    /// Run only the outer (position) loop.
    Outer(RoleArgs),
    /// Run only the inner (attitude and rate) loop.
    Inner(RoleArgs),
    /// Run only the motor mixer.
    Mixer(RoleArgs),
    /// Run only the recorder.
    Record(RecordArgs),
    /// One process of the ring that measures the machine.
    #[command(hide = true)]
    RingHop(HopArgs),
    /// A process that loads the loops' CPU.
    #[command(hide = true)]
    CpuLoad(CpuLoadArgs),
    /// Simulates a lost flight and prints the section of its report on that.
    #[command(hide = true)]
    ExamineLoss { log: PathBuf },
}

impl Cli {
    /// The command line; an argument that must be a text and is none is named.
    pub fn read() -> Result<Self, Failure> {
        Self::try_parse().or_else(|e| {
            match args_os().find(|argument| argument.to_str().is_none()) {
                Some(argument) if e.kind() == ErrorKind::InvalidUtf8 => Err(Failure::usage(
                    format!("{argument:?} is not UTF-8, as settings and logs are"),
                )
                .help("rename the file or its folder")),
                _ => e.exit(),
            }
        })
    }
}

/// The overrides of the flags that were given.
fn overrides<const N: usize>(flags: [Option<(&'static str, Value)>; N]) -> Overrides {
    flags.into_iter().flatten().collect()
}

/// An override of the setting `key`, if its flag was given.
fn set<V: Into<Value>>(key: &'static str, value: Option<V>) -> Option<(&'static str, Value)> {
    Some((key, value?.into()))
}
