//! The sections of the settings with their keys, and what follows from them: texts, trajectory, gates, log plan.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use analysis::gates::{RequestedGates, TheoremGate};
use analysis::verdicts::FlightLimits;
use controller::trajectory::UnknownTrajectory;
use controller::{ScaledTrajectory, Trajectory};
use errors::Failure;
use flight_log::facts::LogPlan;
use messages::blackboards::LOCKSTEP;
use messages::limits::RotorLimits;
use messages::realtime::RealtimeMode;
use messages::role::{Channel, MOST_CHANNELS, Role};
use plant::{Ground, Initial};
use render::flight;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::airframe;
use crate::declarations::{Allowed, Flag, Group, Notation, Section, commented, section};
use crate::law_settings::{self, Moved};
use crate::toml_access::DEFAULT_TABLE;
use crate::trajectory::{self, PointsFile, TrajectorySection};

/// Sections that all roles of a run must share, in the order of their common text.
const SHARED_SECTIONS: &str =
    "flight trajectory initial ground airframe plant model rotor outer inner mixer";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    pub flight: FlightSettings,
    pub initial: Initial,
    pub ground: GroundSection,
    pub trajectory: TrajectorySection,
    /// What the airframe was built with, by parameter name; the ranges of its parameters follow from it.
    #[serde(default = "airframe::paper")]
    pub airframe: BTreeMap<String, f64>,
    /// The true airframe at tick 0, by parameter name.
    pub plant: PlantSection,
    /// The airframe as the laws know it, by parameter name.
    pub model: BTreeMap<String, f64>,
    pub rotor: RotorLimits,
    /// The name of the outer law, and its settings; likewise the next two.
    pub outer: Table,
    pub inner: Table,
    pub mixer: Table,
    pub rt: RealtimeSection,
    pub simplex: SimplexSection,
    /// The laws of single channels that are not those above.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub channel: BTreeMap<Channel, BTreeMap<Role, Table>>,
    pub recorder: RecorderSettings,
    /// Of the channels that fly these laws, the first one; none in the settings of a whole flight.
    #[serde(skip)]
    pub group: Option<Channel>,
    #[serde(skip)]
    pub points: Option<PointsFile>,
    /// Where files of laws are now.
    #[serde(skip)]
    pub moved: Moved,
    /// What the names of outer, inner and mixer law are shown with, in a comparison of one law with several settings.
    #[serde(skip)]
    pub variants: [String; 3],
}

section! { "flight" "The flight."
    pub struct FlightSettings {
        /// Reference trajectory: a name, or a CSV file with the columns t,x,y,z,yaw.
        trajectory: String = "\"lissajous\"",
            flag Flag::new("--trajectory", "TRAJECTORY", Group::Flight).written(Notation::Trajectory);
        /// Airframe: paper, crazyflie, x500, or an airframe file. Keys in [plant], [model] and [rotor] override it.
        airframe: String = "\"paper\"",
            flag Flag::new("--airframe", "NAME|FILE.toml", Group::Flight)
                .help("Airframe: paper, crazyflie, x500, or an airframe file");
        /// SHA-256 of the airframe file, checked if not empty; recorded with each flight.
        airframe_sha256: String = "\"\"";
        /// Preset for every law that has one with this name. Keys in [outer], [inner] and [mixer] override it.
        preset: String = "\"flight\"",
            flag Flag::new("--preset", "PRESET", Group::Flight)
                .written(Notation::Preset)
                .help("Preset for every law that has one with this name");
        /// Length of the flight [s]. A 30 s flight at 1 kHz has ticks 0 to 30000.
        duration_s: f64 = "30.0",
            flag Flag::new("--duration", "DURATION", Group::Flight)
                .written(Notation::Duration)
                .default("30s; margin: one period of the trajectory")
                .help("Length of the flight, for example 30s or 2m");
        /// Sample time of the laws [s], and length of a tick in real time.
        period_s: f64 = "0.001",
            flag Flag::new("--rate", "HZ", Group::Flight)
                .written(Notation::Rate)
                .default("1k")
                .help("Rate of the loop in Hz or kHz, for example 500 or 4k");
        /// Source of the ticks.
        pace: PaceName = "\"realtime\"",
            in Allowed::OneOf(&[
                ("realtime", "the clock: one tick per period, whether or not every stage is ready"),
                ("lockstep", "the chain itself: the next tick begins when the rotor command has arrived; not real-time"),
            ]),
            flag Flag::new("--pace", "PACE", Group::RealTime);
        /// Slow motion: each tick takes this many periods of real time, up to 1 s. The sample time does not change.
        slowdown: u64 = "1", in Allowed::Range(1.0, 1000.0);
        /// Seed of sensor noise, gusts and random faults.
        seed: u64 = "1",
            flag Flag::new("--seed", "N", Group::Flight);
        /// Faults to inject, with the syntax of --fault: ["rotational_drag_nm_s=0.315@8s", "setpoint.drop=0.1@9s"].
        faults: Vec<String> = "[]";
        /// A larger position error ends the flight [m].
        position_error_max_m: f64 = "10.0", in Allowed::Range(0.01, 1e4);
        /// Largest position error in the last 5 s of a flight that tracked [m].
        tracking_error_max_m: f64 = "0.1", in Allowed::Range(0.0, 1e4);
        /// Largest yaw error in the last 5 s of a flight that tracked [rad].
        tracking_yaw_error_max_rad: f64 = "0.1", in Allowed::Range(0.0, PI);
        /// A larger angle between body z and the vertical ends the flight [rad]; pi means no limit.
        tilt_max_rad: f64 = "3.141592653589793", in Allowed::Range(0.1, PI);
        /// Height of the ground [m]; below it the flight counts as lost.
        ground_z_m: f64 = "-0.25", in Allowed::Range(-1e4, 0.0);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PaceName {
    Realtime,
    Lockstep,
}

section! { "ground" "The ground, a plane at flight.ground_z_m."
    #[derive(Copy)]
    pub struct GroundSection {
        /// Whether the airframe touches the ground.
        contact: ContactName = "\"off\"",
            in Allowed::OneOf(&[
                ("off", "no contact"),
                ("plane", "the airframe lands, slides or crashes; a crash ends the flight"),
            ]);
        /// Distance from the rotor plane to the feet and to the top [m].
        leg_m: f64 = "0.05", in Allowed::Range(0.001, 2.0);
        /// Coefficient of friction.
        friction: f64 = "0.6", in Allowed::Range(0.0, 2.0);
        /// A faster touchdown is a crash [m/s].
        crash_speed_m_s: f64 = "2.0", in Allowed::Range(0.0, 100.0);
        /// A touchdown with a larger tilt is a crash [rad].
        crash_tilt_rad: f64 = "0.7853981633974483", in Allowed::Range(0.0, PI);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ContactName {
    Off,
    Plane,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlantSection {
    pub substeps: u32,
    #[serde(flatten)]
    pub parameters: BTreeMap<String, f64>,
}

impl PlantSection {
    pub(crate) const SECTION: Section = section! { rows "plant"
        "The true airframe at tick 0. `ironbird inject` changes it in flight; noise, bias and delay of 0 mean none."
        /// Runge-Kutta steps per tick: fewer are faster and less accurate (`ironbird docs plant`).
        substeps = "4", in Allowed::Counts(&[1, 2, 4]);
    }
    .with(|_| true);
}

section! { "rt" "Real-time execution and redundant channels."
    pub struct RealtimeSection {
        /// Whether to insist on real-time privileges.
        mode: RealtimeMode = "\"prefer\"",
            in Allowed::OneOf(&[
                ("require", "exit with code 4 if SCHED_FIFO, locked memory or anything else is refused, except /dev/cpu_dma_latency"),
                ("prefer", "fly with what is granted, and report what was not"),
                ("off", "request nothing"),
            ]),
            flag Flag::new("--rt", "RT", Group::RealTime).needs_clock();
        /// SCHED_FIFO priority of the plant; outer, inner and mixer get the next higher ones.
        priority: i32 = "80", in Allowed::Range(1.0, 95.0);
        /// CPU of the four loops; auto: the highest-numbered one.
        cpu: Value = "\"auto\"",
            flag Flag::new("--cpu", "N", Group::RealTime)
                .written(Notation::Processor)
                .default("the highest-numbered one")
                .help("CPU of the four loops")
                .needs_clock();
        /// Number of CPUs that the four loops share: 1, 2 or 4.
        ///
        /// On more than one, each stage is woken before its input comes, and reads shared memory in a loop until then: a
        /// shorter loop for more CPU time. `ironbird doctor` flies each number and recommends one. Lockstep and slow motion
        /// ignore it.
        loop_cpus: usize = "1",
            in Allowed::Counts(&[1, 2, 4]),
            flag Flag::new("--loop-cpus", "N", Group::RealTime);
        /// Redundant control channels.
        ///
        /// Each is a complete chain of outer, inner and mixer processes. The plant takes the command of channel a if it is
        /// fresh and on time, else that of channel b or c. With three, the majority wins where commands differ.
        channels: usize = "1",
            in Allowed::Range(1.0, MOST_CHANNELS as f64),
            flag Flag::new("--channels", "N", Group::RealTime);
        /// CPUs of the channels: 1, or 2 to fly channels b and c on another one.
        channel_cpus: usize = "1",
            in Allowed::Range(1.0, 2.0),
            flag Flag::new("--channel-cpus", "N", Group::RealTime).needs_clock();
        /// How early the plant's timer fires before each tick: microseconds, or auto.
        ///
        /// The plant spends the rest reading the clock. `auto` measures the machine before take-off and follows the flight;
        /// without SCHED_FIFO it is 0.
        lead_us: Value = "\"auto\"",
            flag Flag::new("--lead", "US", Group::RealTime).written(Notation::WholeOrAuto).needs_clock();
        /// The flight ends if no process makes progress for this long before tick 0 [s].
        start_timeout_s: f64 = "10.0", in Allowed::Range(1.0, 3600.0);
        /// Whether every stage does a warm-up run on a copy before each tick.
        rehearse: bool = "true",
            flag Flag::new("--rehearse", "BOOL", Group::RealTime).needs_clock();
    }
}

section! { "simplex" "When a channel that flies other laws takes over."
    #[derive(Copy)]
    pub struct SimplexSection {
        /// Let a channel with other laws take over when the present one sends no fresh command on time or exceeds one of
        /// these limits.
        enabled: bool = "false",
            flag Flag::new("--simplex", "", Group::Channels)
                .written(Notation::Switch)
                .help("Let a channel with other laws take over when the present one sends nothing or leaves the limits of [simplex]");
        /// Measured angle between the body z axis and the vertical [rad].
        tilt_max_rad: f64 = "0.8", in Allowed::Range(0.01, PI);
        /// Magnitude of the measured body rate [rad/s].
        rate_max_rad_s: f64 = "6.0", in Allowed::Range(0.01, 1e4);
        /// Distance of the measured position from the reference [m].
        error_max_m: f64 = "0.5", in Allowed::Range(0.01, 1e4);
        /// Change of a rotor's command from one tick to the next [rad/s].
        command_step_max_rad_s: f64 = "150.0", in Allowed::Range(0.01, 1e5);
    }
}

section! { "recorder" "The recorder. Gates: exit code 3 if one fails or measured nothing; a negative value switches a gate off."
    pub struct RecorderSettings {
        /// Directory in which the flight gets its own directory.
        out: String = "\"runs\"", flag Flag::new("--out", "DIR", Group::Record);
        /// Messages to keep in flight.mcap.
        log: LogName = "\"all\"",
            in Allowed::OneOf(&[
                ("all", "all messages; only such a log can be replayed"),
                (
                    "around-misses",
                    "messages within recorder.log_around_s of a missed deadline, a parameter change, take-off or landing",
                ),
                ("off", "none; there is no flight.mcap"),
            ]),
            flag Flag::new("--log", "MESSAGES", Group::Record);
        /// Flight time that around-misses keeps before and after each event [s]; the recorder holds it in memory.
        log_around_s: f64 = "1.0", in Allowed::Range(0.0, 10.0);
        /// Size at which the log continues in flight.1.mcap, flight.2.mcap, ... [MB].
        log_file_mb: u64 = "1024", in Allowed::Range(1.0, 1e6);
        /// Number of newest log files to keep, at least 2; 0 keeps all.
        log_files: u64 = "0";
        /// Length of an interval in latency.hlog, in whole seconds.
        hlog_every_s: u64 = "1", in Allowed::Range(1.0, 3600.0);
        /// Write one row of states every N ticks.
        states_every_ticks: u64 = "50",
            in Allowed::Range(1.0, 1e9),
            flag Flag::new("--every", "N", Group::States);
        /// Trace the loops' CPU with ftrace, so that the report can name what ran during an outage.
        trace: bool = "false",
            flag Flag::new("--trace", "", Group::Record).written(Notation::Switch).needs_clock();
        /// Maximum rate of ticks without a fresh command on time [per million].
        max_miss_rate_ppm: f64 = "-1.0", in Allowed::Limit, flag gate("--max-miss-rate", "PPM", Group::TimingGates);
        /// Maximum rate of skipped ticks [per million].
        max_skip_rate_ppm: f64 = "-1.0", in Allowed::Limit, flag gate("--max-skip-rate", "PPM", Group::TimingGates);
        /// Maximum rate of ticks in which a stage used a stale input [per million].
        max_stale_rate_ppm: f64 = "-1.0", in Allowed::Limit, flag gate("--max-stale-rate", "PPM", Group::TimingGates);
        /// Maximum 99.9th percentile of the plant's wake-up latency [us].
        max_wake_p999_us: f64 = "-1.0", in Allowed::Limit, flag gate("--max-wake-p999", "US", Group::TimingGates);
        /// Maximum 99.9th percentile of the loop latency [us].
        max_loop_p999_us: f64 = "-1.0", in Allowed::Limit, flag gate("--max-loop-p999", "US", Group::TimingGates);
        /// Maximum position error in the last 5 s [m]; the yaw error then is limited, too (flight.tracking_yaw_error_max_rad).
        max_tracking_error_m: f64 = "-1.0", in Allowed::Limit, flag gate("--max-tracking-error", "M", Group::FlightGates);
        /// Maximum yaw error in the last 5 s [rad].
        max_yaw_error_rad: f64 = "-1.0", in Allowed::Limit, flag gate("--max-yaw-error", "RAD", Group::FlightGates);
        /// Maximum share of ticks in which the rotors could not deliver the demand [%].
        max_saturated_percent: f64 = "-1.0", in Allowed::Share, flag gate("--max-saturated", "PERCENT", Group::FlightGates);
        /// Maximum rms change of a rotor's command from tick to tick [rad/s].
        max_agitation_rad_s: f64 = "-1.0", in Allowed::Limit, flag gate("--max-agitation", "RAD_S", Group::FlightGates);
        /// Maximum share of the loops' CPU time that the host steals [%].
        max_steal_percent: f64 = "-1.0", in Allowed::Share, flag gate("--max-steal", "PERCENT", Group::TimingGates);
        /// The theorem must hold without an unexplained violation (`ironbird docs theorem`).
        gate_theorem: bool = "false";
        /// The theorem must hold, and a broken assumption of it excuses nothing.
        gate_theorem_strict: bool = "false";
        /// Channels with the same laws, states and inputs must have the same commands.
        gate_channels: bool = "false";
    }
}

/// The flag of a gate, which has no limit by default.
const fn gate(name: &'static str, value: &'static str, group: Group) -> Flag {
    Flag::new(name, value, group).default("")
}

/// Messages that the flight log keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogName {
    All,
    AroundMisses,
    Off,
}

impl Settings {
    /// The full commented settings, with these values.
    pub fn commented(&self) -> Result<String, Failure> {
        let table = Table::try_from(self).map_err(|e| Failure::failed(e.to_string()))?;
        let mut text = commented(&table);
        if self.flight.airframe != airframe::PAPER || self.airframe != airframe::paper() {
            text += &airframe::commented(&self.airframe);
        }
        for (role, section) in self.law_sections() {
            text += &law_settings::commented(role, role.name(), section, &self.moved)?;
        }
        for (channel, role, section) in self.channel_laws() {
            let name = format!("channel.{channel}.{role}");
            text += &law_settings::commented(role, &name, section, &self.moved)?;
        }
        Ok(text)
    }

    /// The settings with the points that their trajectory names, if it is a file.
    pub(super) fn with_points(mut self) -> Result<Self, Failure> {
        if !trajectory::is_file(&self.flight.trajectory) {
            let (sum, trajectory) = (&self.trajectory.sha256, &self.flight.trajectory);
            if sum.is_empty() {
                return Ok(self);
            }
            return Err(Failure::usage(format!(
                "trajectory.sha256 = \"{sum}\": the trajectory `{trajectory}` is not a file"
            ))
            .help("take trajectory.sha256 out of the settings, or name the CSV file in flight.trajectory"));
        }
        let read = PointsFile::read(&self.flight.trajectory, self.trajectory.tolerance)?;
        self.take_points(read)?;
        Ok(self)
    }

    /// Takes the points of the trajectory, if they are those that the settings have the hash of.
    pub fn take_points(&mut self, points: PointsFile) -> Result<(), Failure> {
        let wanted = &self.trajectory.sha256;
        if !wanted.is_empty() && *wanted != points.sha256 {
            return Err(Failure::usage(format!(
                "trajectory file {}: its SHA-256 is {}, but the settings were made for {wanted}",
                self.flight.trajectory, points.sha256
            ))
            .help("the file has changed: bring the old one back, or take trajectory.sha256 out of the settings"));
        }
        self.trajectory.sha256.clone_from(&points.sha256);
        self.points = Some(points);
        Ok(())
    }

    /// Reads the settings that a flight recorded. Settings that are newer than the flight get their defaults.
    pub fn recorded(text: &str) -> Result<Self, toml::de::Error> {
        let mut table: Table = text.parse()?;
        for (section, defaults) in DEFAULT_TABLE.clone() {
            let own = table.entry(section).or_insert_with(|| Table::new().into());
            if let (Value::Table(own), Value::Table(defaults)) = (own, defaults) {
                for (key, default) in defaults {
                    own.entry(key).or_insert(default);
                }
            }
        }
        table.try_into()
    }

    /// What all roles of a run must share: one `section.key = value` a line.
    pub fn shared_text(&self) -> Result<String, Failure> {
        let table = Table::try_from(self).map_err(|e| Failure::failed(e.to_string()))?;
        let mut text = String::new();
        for section in SHARED_SECTIONS.split(' ') {
            for (key, value) in table[section].as_table().into_iter().flatten() {
                text.push_str(&format!("{section}.{key} = {value}\n"));
            }
        }
        for (channel, role, section) in self.channel_laws() {
            for (key, value) in section {
                text.push_str(&format!("channel.{channel}.{role}.{key} = {value}\n"));
            }
        }
        Ok(text)
    }

    pub fn course(&self) -> Result<ScaledTrajectory, Failure> {
        let TrajectorySection { size, period, .. } = self.trajectory;
        let course = match &self.points {
            Some(points) => points.course,
            None => self.flight.trajectory.parse().map(ScaledTrajectory::of).map_err(
                |UnknownTrajectory(name)| {
                    let names = Trajectory::ALL.map(|it| format!("`{it}`"));
                    Failure::usage(format!(
                        "settings: unknown variant `{name}`, expected one of {}, or a CSV file, in `flight.trajectory`",
                        names.join(", ")
                    ))
                    .help("see `ironbird fly --print-config`")
                },
            )?,
        };
        Ok(course.stretched(size, period))
    }

    /// The trajectory in a word, for titles.
    pub fn trajectory_name(&self) -> &str {
        last_name(&self.flight.trajectory)
    }

    pub fn airframe_name(&self) -> &str {
        last_name(&self.flight.airframe)
    }

    pub fn conditions(&self) -> String {
        let airframe = flight::airframe(self.airframe_name(), &self.flight.airframe_sha256);
        flight::conditions(self.trajectory_name(), &self.flight.preset, &airframe)
    }

    /// Limits by which the flight counts as tracked, off track or lost.
    pub const fn flight_limits(&self) -> FlightLimits {
        FlightLimits {
            error_max_m: self.flight.tracking_error_max_m,
            yaw_error_max_rad: self.flight.tracking_yaw_error_max_rad,
            ground_z_m: self.flight.ground_z_m,
            position_error_max_m: self.flight.position_error_max_m,
        }
    }

    pub fn last_tick(&self) -> u64 {
        (self.flight.duration_s / self.flight.period_s).round() as u64
    }

    /// Sample time of the laws [ns].
    pub fn sample_time_ns(&self) -> u64 {
        (self.flight.period_s * 1e9).round() as u64
    }

    /// Length of a tick on the clock [ns], or [`LOCKSTEP`].
    pub fn wall_period_ns(&self) -> u64 {
        match self.flight.pace {
            PaceName::Realtime => self.sample_time_ns() * self.flight.slowdown,
            PaceName::Lockstep => LOCKSTEP,
        }
    }

    pub fn log_plan(&self) -> LogPlan {
        let recorder = &self.recorder;
        let around_ticks = (recorder.log_around_s / self.flight.period_s).round() as u64;
        LogPlan {
            around_ticks: (recorder.log == LogName::AroundMisses).then_some(around_ticks),
            file_bytes: recorder.log_file_mb * 1_000_000,
            files: Some(recorder.log_files).filter(|files| *files > 0),
        }
    }

    pub fn requested_gates(&self) -> RequestedGates {
        let limit = |limit: f64| (limit >= 0.0).then_some(limit);
        let recorder = &self.recorder;
        let max_tracking_error_m = limit(recorder.max_tracking_error_m);
        // A flight that points elsewhere has not tracked.
        let implied = max_tracking_error_m.map(|_| self.flight.tracking_yaw_error_max_rad);
        RequestedGates {
            limits: self.flight_limits(),
            tilt_max_rad: self.flight.tilt_max_rad,
            max_miss_rate_ppm: limit(recorder.max_miss_rate_ppm),
            max_skip_rate_ppm: limit(recorder.max_skip_rate_ppm),
            max_stale_rate_ppm: limit(recorder.max_stale_rate_ppm),
            max_wake_p999_us: limit(recorder.max_wake_p999_us),
            max_loop_p999_us: limit(recorder.max_loop_p999_us),
            max_tracking_error_m,
            max_yaw_error_rad: limit(recorder.max_yaw_error_rad).or(implied),
            max_saturated_percent: limit(recorder.max_saturated_percent),
            max_agitation_rad_s: limit(recorder.max_agitation_rad_s),
            max_steal_percent: limit(recorder.max_steal_percent),
            theorem: recorder.theorem_gate(),
            channels: recorder.gate_channels,
        }
    }
}

/// The last part of a path, or a name.
pub fn last_name(path: &str) -> &str {
    path.rsplit_once('/').map_or(path, |(_, file)| file)
}

impl RecorderSettings {
    pub fn theorem_gate(&self) -> Option<TheoremGate> {
        let lenient = self.gate_theorem.then_some(TheoremGate::Lenient);
        let strict = self.gate_theorem_strict.then_some(TheoremGate::Strict);
        strict.or(lenient)
    }
}

impl GroundSection {
    /// The plane at `z_m` [m], if there is one.
    pub fn plane(&self, z_m: f64) -> Option<Ground> {
        (self.contact == ContactName::Plane).then_some(Ground {
            z_m,
            leg_m: self.leg_m,
            friction: self.friction,
            crash_speed_m_s: self.crash_speed_m_s,
            crash_tilt_rad: self.crash_tilt_rad,
        })
    }
}
