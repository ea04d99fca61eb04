//! Flags of the commands that fly: `fly`, `simulate` and the single roles.

use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, ValueEnum};
use toml::Value;

use crate::cli::setting_flags::{
    CHANNELS, FLIGHT, FLIGHT_GATES, REAL_TIME, RECORD, STATES, SettingFlags, TIMING_GATES,
};
use crate::cli::{PageArgs, overrides, set, values};
use config::Overrides;
use faults::grammar::Fault;
use messages::role::Channel;

/// The flight, whatever laws fly it.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct TrajectoryArgs {
    #[command(flatten)]
    pub settings: SettingFlags<FLIGHT>,
    /// Settings file (TOML); flags override it. Relative paths in it start at its folder.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Setting by its key, as in inner.alpha_1_s=150; may be repeated. It overrides the settings file; other flags
    /// override it. `--print-config` of `fly` lists the keys.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = values::setting)]
    pub set: Vec<(&'static str, Value)>,
    /// Fault to inject: 'WHAT=VALUE[,WHAT=VALUE]@8s' or '...@tick8000', with an end as in @8s..9s; may be repeated.
    /// A parameter takes a number, `nominal`, or +30% of nominal; ~2s after it makes a 2 s ramp.
    /// `ironbird params` and `ironbird faults` list what can be changed.
    #[arg(long = "fault", value_name = "FAULT", value_parser = values::fault)]
    pub faults: Vec<Fault>,
}

impl TrajectoryArgs {
    pub fn overrides(&self) -> Overrides {
        let faults = (!self.faults.is_empty())
            .then(|| self.faults.iter().map(Fault::to_string).collect::<Vec<_>>());
        let faults = overrides([set("flight.faults", faults)]);
        [self.set.clone(), self.settings.overrides(), faults].concat()
    }
}

/// The flight and its laws.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct FlightArgs {
    #[command(flatten)]
    pub course: TrajectoryArgs,
    /// Law of the outer loop: a name from `ironbird laws`, or a library such as ./libmy.so [default: pd].
    #[arg(long, value_name = "LAW|FILE")]
    pub outer: Option<String>,
    /// Law of the inner loop [default: adaptive].
    #[arg(long, visible_alias = "controller", value_name = "LAW|FILE")]
    pub inner: Option<String>,
    /// Law of the mixer [default: roll_pitch_first].
    #[arg(long, value_name = "LAW|FILE")]
    pub mixer: Option<String>,
}

impl FlightArgs {
    pub fn overrides(&self) -> Overrides {
        let laws = overrides([
            set("outer.law", self.outer.clone()),
            set("inner.law", self.inner.clone()),
            set("mixer.law", self.mixer.clone()),
        ]);
        [self.course.overrides(), laws].concat()
    }
}

/// Real-time execution.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Real time")]
pub struct RtArgs {
    #[command(flatten)]
    pub settings: SettingFlags<REAL_TIME>,
    /// Name of the instance; several can fly at once.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Acceptance criteria.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Gates: exit code 3 if one fails or measured nothing")]
pub struct GateArgs {
    #[command(flatten)]
    pub timing: SettingFlags<TIMING_GATES>,
    #[command(flatten)]
    pub flight: FlightGateArgs,
}

/// Those that need no clock.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Gates: exit code 3 if one fails or measured nothing")]
pub struct FlightGateArgs {
    #[command(flatten)]
    pub limits: SettingFlags<FLIGHT_GATES>,
    /// A condition that must hold; may be repeated.
    #[arg(long = "gate", value_enum, value_name = "GATE")]
    pub gates: Vec<GateName>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GateName {
    /// No unexplained violation of the theorem, and estimates that move as predicted.
    Theorem,
    /// The same, and no assumption of the theorem may be broken in any step.
    #[value(name = "theorem=strict")]
    TheoremStrict,
    /// Channels with the same laws, states and inputs have the same commands in every tick.
    Channels,
}

impl GateArgs {
    pub fn overrides(&self) -> Overrides {
        [self.timing.overrides(), self.flight.overrides()].concat()
    }
}

impl FlightGateArgs {
    fn overrides(&self) -> Overrides {
        let asked = |key, gate| set(key, self.gates.contains(&gate).then_some(true));
        let gates = overrides([
            asked("recorder.gate_theorem", GateName::Theorem),
            asked("recorder.gate_theorem_strict", GateName::TheoremStrict),
            asked("recorder.gate_channels", GateName::Channels),
        ]);
        [self.limits.overrides(), gates].concat()
    }
}

/// What the recorder writes, and the acceptance criteria.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Record")]
pub struct RecorderArgs {
    #[command(flatten)]
    pub settings: SettingFlags<RECORD>,
    /// Also write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    #[command(flatten)]
    pub every: SettingFlags<STATES>,
    #[command(flatten)]
    pub gates: GateArgs,
}

impl RecorderArgs {
    pub fn overrides(&self) -> Overrides {
        [
            self.settings.overrides(),
            self.every.overrides(),
            self.gates.overrides(),
        ]
        .concat()
    }
}

#[derive(Clone, Debug, Default, Args)]
#[command(group(ArgGroup::new("served").args(["web", "mavlink"]).multiple(true)))]
pub struct FlyArgs {
    /// Show the dashboard in this terminal, as `ironbird watch` does.
    #[arg(long)]
    pub watch: bool,
    /// Serve the live page of the flight to browsers on this machine, and print its address.
    #[arg(long)]
    pub web: bool,
    #[command(flatten)]
    pub page: PageArgs,
    /// Let the live page and the ground station change parameters and inject faults.
    #[arg(long, requires = "served")]
    pub allow_control: bool,
    /// Report the flight to a MAVLink ground station on this machine (UDP port 14550), as `ironbird bridge mavlink` does.
    #[arg(long)]
    pub mavlink: bool,
    /// Fly another law in channel b or c, for example b:inner=pid. It flies on request (`ironbird switch`), or with --simplex.
    #[arg(long, value_name = "LETTER:ROLE=LAW")]
    pub channel: Vec<String>,
    #[command(flatten)]
    pub simplex: SettingFlags<CHANNELS>,
    /// What to do when a process dies or hangs in flight [default: end; restart with more than one channel].
    #[arg(long, value_enum, value_name = "WHAT")]
    pub on_death: Option<OnDeath>,
    /// Measure each of the machine's timing limits for this long right after the flight, for example 11s.
    #[arg(long, value_name = "DURATION", allow_hyphen_values = true, value_parser = values::duration)]
    pub floor: Option<Duration>,
    /// Write the acceptance results to FILE as JUnit XML.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Open the report page in a browser after the flight, and with --web the live page at its start: the browser named by
    /// BROWSER, or the system's.
    #[arg(long)]
    pub open: bool,
    /// Print the complete, commented settings of this flight, and exit.
    #[arg(long)]
    pub print_config: bool,
    #[command(flatten)]
    pub flight: FlightArgs,
    #[command(flatten)]
    pub rt: RtArgs,
    #[command(flatten)]
    pub recorder: RecorderArgs,
}

impl FlyArgs {
    pub fn overrides(&self) -> Overrides {
        let laws = (!self.channel.is_empty()).then(|| self.channel.clone());
        let laws = overrides([set("channel.laws", laws)]);
        [
            self.flight.overrides(),
            self.rt.settings.overrides(),
            self.recorder.overrides(),
            laws,
            self.simplex.overrides(),
        ]
        .concat()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OnDeath {
    /// End the flight, and name the process that died. With several channels the flight goes on with those that are whole.
    End,
    /// Start it again, at most 5 times in 10 s. The new process continues from the state of another channel, or of the one
    /// that died. A process that hangs for more than 80 ms is killed first. The flight ends if the plant dies.
    Restart,
}

/// Flags of `plant`, `outer`, `inner` and `mixer`.
#[derive(Clone, Debug, Args)]
pub struct RoleArgs {
    #[command(flatten)]
    pub flight: FlightArgs,
    #[command(flatten)]
    pub rt: RtArgs,
    #[arg(from_global)]
    pub launcher: Option<u32>,
    /// Processors that this process may use: its launcher keeps to some of them.
    #[arg(long, hide = true, value_delimiter = ',')]
    pub allowed_cpus: Vec<usize>,
    /// Channel of the role in a flight with several: a, b or c.
    #[arg(long, value_name = "LETTER", default_value = "a", value_parser = values::channel)]
    pub channel: Channel,
}

#[derive(Clone, Debug, Args)]
pub struct RecordArgs {
    #[command(flatten)]
    pub role: RoleArgs,
    #[command(flatten)]
    pub recorder: RecorderArgs,
    /// The flight's directory, which exists.
    #[arg(long, hide = true)]
    pub run_dir: Option<PathBuf>,
}

#[derive(Clone, Debug, Args)]
pub struct SimulateArgs {
    #[command(flatten)]
    pub flight: FlightArgs,
    /// Plot the flight to this file.
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Apply the outages, skipped ticks and stale inputs of this recorded flight: its directory, its log, or latest.
    #[arg(long, value_name = "RUN")]
    pub timing: Option<PathBuf>,
    /// Directory in which `latest` is looked up [default: runs].
    #[arg(long, value_name = "DIR", requires = "timing")]
    pub out: Option<PathBuf>,
    /// Write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    #[command(flatten)]
    pub every: SettingFlags<STATES>,
    /// Write the acceptance results to FILE as JUnit XML.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    #[command(flatten)]
    pub gates: FlightGateArgs,
}

impl SimulateArgs {
    pub fn overrides(&self) -> Overrides {
        [
            self.flight.overrides(),
            self.every.overrides(),
            self.gates.overrides(),
        ]
        .concat()
    }
}
