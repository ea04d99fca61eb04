//! Flags of the commands that fly: `fly`, `simulate` and the single roles.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use errors::Failure;
use toml::Value;

use crate::cli::values::{self, NumberOrAuto};
use crate::cli::{name_of, overrides, set};
use config::{Overrides, PaceName, Settings};
use faults::grammar::Fault;
use messages::role::{Channel, MOST_CHANNELS};

/// The flight, whatever laws fly it.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct TrajectoryArgs {
    /// Reference trajectory: a name, or a CSV file with the columns t,x,y,z,yaw [default: lissajous].
    #[arg(long, value_parser = values::TRAJECTORY)]
    pub trajectory: Option<String>,
    /// Airframe: paper, crazyflie, x500, or an airframe file [default: paper].
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub airframe: Option<String>,
    /// Preset for every law that has one with this name [default: flight].
    #[arg(long, value_parser = values::PRESET)]
    pub preset: Option<String>,
    /// Length of the flight, for example 30s or 2m [default: 30s; margin: one period of the trajectory].
    #[arg(long, allow_hyphen_values = true, value_parser = values::duration)]
    pub duration: Option<Duration>,
    /// Rate of the loop in Hz or kHz, for example 500 or 4k [default: 1k].
    #[arg(long, value_name = "HZ", allow_hyphen_values = true, value_parser = values::period_s)]
    pub rate: Option<f64>,
    /// Seed of sensor noise, gusts and random faults [default: 1].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::within(0..=i64::MAX))]
    pub seed: Option<i64>,
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
        let flags = overrides([
            set("flight.trajectory", self.trajectory.clone()),
            set("flight.airframe", self.airframe.clone()),
            set("flight.preset", self.preset.clone()),
            set(
                "flight.duration_s",
                self.duration.map(|it| it.as_secs_f64()),
            ),
            set("flight.period_s", self.rate),
            set("flight.seed", self.seed),
            set("flight.faults", faults),
        ]);
        [self.set.clone(), flags].concat()
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
    #[arg(long, value_name = "LAW|FILE")]
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
    /// Whether to insist on real-time privileges [default: prefer].
    #[arg(long, value_enum)]
    pub rt: Option<RtMode>,
    /// What advances the ticks [default: realtime].
    #[arg(long, value_enum)]
    pub pace: Option<PaceArg>,
    /// CPU of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::processor)]
    pub cpu: Option<u16>,
    /// How many CPUs the four loops share: 1, 2, 4, or auto [default: 1].
    ///
    /// On more than one, each stage is woken before its input comes, and reads shared memory in a loop until then: a
    /// shorter loop for more CPU time. `auto` flies each number for 2 s first, and takes what `ironbird doctor` would
    /// recommend. Lockstep and slow motion ignore it.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::number_or_auto)]
    pub loop_cpus: Option<NumberOrAuto>,
    /// Redundant control channels, 1 to 3 [default: 1].
    ///
    /// Each is a complete chain of outer, inner and mixer processes. The plant takes the command of channel a if it is
    /// fresh and on time, else that of channel b or c. With three, the majority wins where commands differ.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::within(1..=MOST_CHANNELS as u32))]
    pub channels: Option<u32>,
    /// CPUs of the channels: 1, or 2 to fly channels b and c on another one [default: 1].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::within(1..=2_u32))]
    pub channel_cpus: Option<u32>,
    /// How early the plant's timer fires before each tick: microseconds, or auto [default: auto].
    ///
    /// The plant spends the rest reading the clock. `auto` measures the machine before take-off and follows the flight;
    /// without SCHED_FIFO it is 0.
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::number_or_auto)]
    pub lead: Option<NumberOrAuto>,
    /// Whether the stages do a warm-up run before each tick [default: true].
    #[arg(long, value_name = "BOOL")]
    pub rehearse: Option<bool>,
    /// Name of the instance; several can fly at once.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RtMode {
    /// Exit with code 4 if SCHED_FIFO, locked memory or anything else is refused, except /dev/cpu_dma_latency.
    Require,
    /// Fly with what is granted, and report what was not.
    Prefer,
    /// Request nothing.
    Off,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PaceArg {
    /// The clock: one tick per period, whether or not every stage is ready.
    Realtime,
    /// The chain itself: the next tick begins when the rotor command has arrived. Not real-time.
    Lockstep,
}

/// Refuses flags that need the clock, each with whether it is given, in a lockstep flight.
pub(crate) fn check_clock_flags(
    settings: &Settings,
    flags: &[(&str, bool)],
) -> Result<(), Failure> {
    let given = flags.iter().find(|(_, is_given)| *is_given);
    match (settings.flight.pace, given) {
        (PaceName::Lockstep, Some((flag, _))) => Err(Failure::usage(format!(
            "{flag} has no meaning in lockstep, where no clock moves the ticks"
        ))
        .help(format!(
            "remove {flag}, or fly in real time: --pace realtime"
        ))),
        _ => Ok(()),
    }
}

impl RtArgs {
    /// The flags that need the clock, each with whether it is given.
    pub(crate) fn clock_flags(&self) -> [(&'static str, bool); 5] {
        let wants_rt = self.rt.is_some_and(|mode| !matches!(mode, RtMode::Off));
        [
            ("--rt", wants_rt),
            ("--cpu", self.cpu.is_some()),
            ("--lead", self.lead.is_some()),
            ("--rehearse", self.rehearse.is_some()),
            ("--channel-cpus", self.channel_cpus.is_some()),
        ]
    }

    pub fn overrides(&self) -> Overrides {
        let lead = self.lead.map(|lead| match lead.number() {
            None => Value::from("auto"),
            Some(us) => Value::from(us),
        });
        overrides([
            set("rt.mode", self.rt.map(name_of)),
            set("flight.pace", self.pace.map(name_of)),
            set("rt.cpu", self.cpu.map(i64::from)),
            set(
                "rt.loop_cpus",
                self.loop_cpus.and_then(NumberOrAuto::number),
            ),
            set("rt.channels", self.channels.map(i64::from)),
            set("rt.channel_cpus", self.channel_cpus.map(i64::from)),
            set("rt.lead_us", lead),
            set("rt.rehearse", self.rehearse),
        ])
    }
}

/// Acceptance criteria.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Gates: exit code 3 if one fails or measured nothing")]
pub struct GateArgs {
    /// Maximum rate of ticks without a fresh command on time [per million].
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_miss_rate: Option<f64>,
    /// Maximum rate of skipped ticks [per million].
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_skip_rate: Option<f64>,
    /// Maximum rate of ticks in which a stage used a stale input [per million].
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_stale_rate: Option<f64>,
    /// Maximum 99.9th percentile of the plant's wake-up latency [us].
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_wake_p999: Option<f64>,
    /// Maximum 99.9th percentile of the loop latency [us].
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_loop_p999: Option<f64>,
    #[command(flatten)]
    pub flight: FlightGateArgs,
    /// Maximum share of the loops' CPU time that the host steals [%].
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_steal: Option<f64>,
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
        let limits = overrides([
            set("recorder.max_miss_rate_ppm", self.max_miss_rate),
            set("recorder.max_skip_rate_ppm", self.max_skip_rate),
            set("recorder.max_stale_rate_ppm", self.max_stale_rate),
            set("recorder.max_wake_p999_us", self.max_wake_p999),
            set("recorder.max_loop_p999_us", self.max_loop_p999),
            set("recorder.max_steal_percent", self.max_steal),
        ]);
        [limits, self.flight.overrides(), gate_overrides(&self.gates)].concat()
    }
}

/// Gates that need no clock.
#[derive(Clone, Debug, Default, Args)]
pub struct FlightGateArgs {
    /// Maximum position error in the last 5 s [m]; the yaw error then is limited, too (flight.tracking_yaw_error_max_rad).
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_tracking_error: Option<f64>,
    /// Maximum yaw error in the last 5 s [rad].
    #[arg(long, value_name = "RAD", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_yaw_error: Option<f64>,
    /// Maximum share of ticks in which the rotors could not deliver the demand [%].
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_saturated: Option<f64>,
    /// Maximum rms change of a rotor's command from tick to tick [rad/s].
    #[arg(long, value_name = "RAD_S", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_agitation: Option<f64>,
}

impl FlightGateArgs {
    fn overrides(&self) -> Overrides {
        overrides([
            set("recorder.max_tracking_error_m", self.max_tracking_error),
            set("recorder.max_yaw_error_rad", self.max_yaw_error),
            set("recorder.max_saturated_percent", self.max_saturated),
            set("recorder.max_agitation_rad_s", self.max_agitation),
        ])
    }
}

fn gate_overrides(gates: &[GateName]) -> Overrides {
    let asked = |key, gate| set(key, gates.contains(&gate).then_some(true));
    overrides([
        asked("recorder.gate_theorem", GateName::Theorem),
        asked("recorder.gate_theorem_strict", GateName::TheoremStrict),
        asked("recorder.gate_channels", GateName::Channels),
    ])
}

/// What the recorder writes, and the acceptance criteria.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Record")]
pub struct RecorderArgs {
    /// Directory in which the flight gets its own directory [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Messages to keep in flight.mcap [default: all].
    #[arg(long, value_enum, value_name = "MESSAGES")]
    pub log: Option<LogArg>,
    /// Also write the states to this file.
    #[arg(long, value_name = "FILE.csv")]
    pub states: Option<PathBuf>,
    /// Write one row of states every N ticks [default: 50].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::every)]
    pub every: Option<u32>,
    /// Trace the loops' CPU with ftrace, so that the report can name what ran during an outage.
    #[arg(long)]
    pub trace: bool,
    #[command(flatten)]
    pub gates: GateArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogArg {
    /// All messages; only such a log can be replayed.
    All,
    /// Messages within recorder.log_around_s of a missed deadline, a parameter change, take-off or landing.
    AroundMisses,
    /// None; there is no flight.mcap.
    Off,
}

impl RecorderArgs {
    pub fn overrides(&self) -> Overrides {
        let out = self
            .out
            .as_ref()
            .map(|out| out.to_string_lossy().into_owned());
        let files = overrides([
            set("recorder.out", out),
            set("recorder.log", self.log.map(name_of)),
            set("recorder.states_every_ticks", self.every),
            set("recorder.trace", self.trace.then_some(true)),
        ]);
        [files, self.gates.overrides()].concat()
    }
}

#[derive(Clone, Debug, Default, Args)]
pub struct FlyArgs {
    /// Show the dashboard in this terminal, as `ironbird watch` does.
    #[arg(long)]
    pub watch: bool,
    /// Fly another law in channel b or c, for example b:inner=pid. It flies on request (`ironbird switch`), or with --simplex.
    #[arg(long, value_name = "LETTER:ROLE=LAW")]
    pub channel: Vec<String>,
    /// Let a channel with other laws take over when the present one sends nothing or leaves the limits of [simplex].
    #[arg(long)]
    pub simplex: bool,
    /// What to do when a process dies or hangs in flight [default: end; restart with more than one channel].
    #[arg(long, value_enum, value_name = "WHAT")]
    pub on_death: Option<OnDeath>,
    /// Measure each of the machine's timing limits for this long right after the flight, for example 11s.
    #[arg(long, value_name = "DURATION", allow_hyphen_values = true, value_parser = values::duration)]
    pub floor: Option<Duration>,
    /// Write the acceptance results to FILE as JUnit XML.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Open the report page in a browser after the flight: the one named by BROWSER, or the system's.
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
    pub fn channel_overrides(&self) -> Overrides {
        let laws: Vec<Value> = self
            .channel
            .iter()
            .map(String::as_str)
            .map(Value::from)
            .collect();
        overrides([
            set("channel.laws", (!laws.is_empty()).then_some(laws)),
            set("simplex.enabled", self.simplex.then_some(true)),
        ])
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
    /// Write one row of states every N ticks [default: 50].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::every)]
    pub every: Option<u32>,
    /// Write the acceptance results to FILE as JUnit XML.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    #[command(
        flatten,
        next_help_heading = "Gates: exit code 3 if one fails or measured nothing"
    )]
    pub flight_gates: FlightGateArgs,
    /// A condition that must hold; may be repeated.
    #[arg(long = "gate", value_enum, value_name = "GATE")]
    pub gates: Vec<GateName>,
}

impl SimulateArgs {
    pub fn overrides(&self) -> Overrides {
        let own = overrides([set("recorder.states_every_ticks", self.every)]);
        let gates = [self.flight_gates.overrides(), gate_overrides(&self.gates)];
        [self.flight.overrides(), own, gates.concat()].concat()
    }
}
