//! The sections of the settings with their keys, and what follows from them: texts, trajectory, gates, log plan.

use std::collections::BTreeMap;

use analysis::gates::{RequestedGates, TheoremGate};
use analysis::verdicts::TrackingLimits;
use controller::trajectory::UnknownTrajectory;
use controller::{ScaledTrajectory, Trajectory};
use errors::Failure;
use flight_log::facts::{ALL, AROUND_MISSES, LogPlan, OFF};
use messages::blackboards::LOCKSTEP;
use messages::limits::RotorLimits;
use messages::realtime::RealtimeMode;
use messages::role::{Channel, Role};
use messages::telemetry::LAW_ROLES;
use plant::{Ground, Initial};
use render::flight;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::airframe;
use crate::law_settings::{self, Moved};
use crate::toml_access::{DEFAULT, same};
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
    #[serde(default)]
    pub trajectory: TrajectorySection,
    /// What the airframe was built with, by parameter name; the ranges of its parameters follow from it.
    #[serde(default = "airframe::paper")]
    pub airframe: BTreeMap<String, f64>,
    /// The true airframe at tick 0, by parameter name.
    pub plant: BTreeMap<String, f64>,
    /// The airframe as the laws know it, by parameter name.
    pub model: BTreeMap<String, f64>,
    pub rotor: RotorLimits,
    /// The name of the outer law, and its settings; likewise the next two.
    pub outer: Table,
    pub inner: Table,
    pub mixer: Table,
    pub rt: RealtimeSection,
    #[serde(default)]
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

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightSettings {
    pub trajectory: String,
    pub airframe: String,
    #[serde(default)]
    pub airframe_sha256: String,
    pub preset: String,
    pub duration_s: f64,
    pub period_s: f64,
    pub pace: PaceName,
    pub slowdown: u64,
    pub seed: u64,
    /// Of earlier versions, whose logs have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resume_estimates: Option<bool>,
    pub faults: Vec<String>,
    pub position_error_max_m: f64,
    pub tracking_error_max_m: f64,
    #[serde(default = "tracking_yaw_error_max_rad")]
    pub tracking_yaw_error_max_rad: f64,
    pub tilt_max_rad: f64,
    pub ground_z_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PaceName {
    Realtime,
    Lockstep,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundSection {
    pub contact: ContactName,
    pub leg_m: f64,
    pub friction: f64,
    pub crash_speed_m_s: f64,
    pub crash_tilt_rad: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ContactName {
    Off,
    Plane,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealtimeSection {
    pub mode: RealtimeMode,
    pub priority: i32,
    /// A number, or "auto"; likewise the next one.
    pub cpu: Value,
    pub lead_us: Value,
    #[serde(default = "one")]
    pub loop_cpus: usize,
    #[serde(default = "one")]
    pub channels: usize,
    #[serde(default = "one")]
    pub channel_cpus: usize,
    #[serde(default = "ten")]
    pub start_timeout_s: f64,
    pub rehearse: bool,
}

/// When a channel with other laws takes over: [`Envelope`](messages::channels::Envelope).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimplexSection {
    pub enabled: bool,
    pub tilt_max_rad: f64,
    pub rate_max_rad_s: f64,
    pub error_max_m: f64,
    pub command_step_max_rad_s: f64,
}

/// How many processors and channels there were before there was a choice.
const fn one() -> usize {
    1
}

/// The yaw limit of settings that have none.
const fn tracking_yaw_error_max_rad() -> f64 {
    0.1
}

/// The limit of a gate in settings that do not know it.
const fn no_limit() -> f64 {
    -1.0
}

/// The time limit of a start in settings that have none.
const fn ten() -> f64 {
    10.0
}

/// What is recorded, and the gates: a negative limit is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecorderSettings {
    pub out: String,
    pub log: LogName,
    pub log_around_s: f64,
    pub log_file_mb: u64,
    pub log_files: u64,
    pub hlog_every_s: u64,
    pub states_every_ticks: u64,
    pub max_miss_rate_ppm: f64,
    pub max_skip_rate_ppm: f64,
    pub max_stale_rate_ppm: f64,
    pub max_wake_p999_us: f64,
    pub max_loop_p999_us: f64,
    pub max_tracking_error_m: f64,
    #[serde(default = "no_limit")]
    pub max_yaw_error_rad: f64,
    #[serde(default = "no_limit")]
    pub max_saturated_percent: f64,
    #[serde(default = "no_limit")]
    pub max_agitation_rad_s: f64,
    pub max_steal_percent: f64,
    pub gate_theorem: bool,
    #[serde(default)]
    pub gate_theorem_strict: bool,
    #[serde(default)]
    pub gate_channels: bool,
    pub trace: bool,
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
        let broken = |e: String| Failure::failed(format!("the commented default is broken: {e}"));
        let mut document: toml_edit::DocumentMut =
            DEFAULT.parse().map_err(|e| broken(format!("{e}")))?;
        let mut table = Table::try_from(self).map_err(|e| broken(e.to_string()))?;
        table.remove("airframe");
        if self.flight.airframe != airframe::PAPER || self.airframe != airframe::paper() {
            let commented = airframe::commented(&self.airframe);
            document.insert("airframe", toml_edit::Item::Table(commented));
        }
        let laws = LAW_ROLES.map(Role::name);
        for section in laws.into_iter().chain(["channel"]) {
            table.remove(section);
        }
        for (section, keys) in &table {
            for (key, value) in keys.as_table().into_iter().flatten() {
                let value = value.to_string().parse::<toml_edit::Value>();
                let value = value.map_err(|e| broken(format!("{section}.{key}: {e}")))?;
                let item = document[section].get_mut(key);
                let Some(item) = item.and_then(toml_edit::Item::as_value_mut) else {
                    return Err(broken(format!("{section}.{key} is not in it")));
                };
                // An unchanged value keeps the way it is written (2e-4, not 0.0002).
                if !same(item, &value) {
                    let decor = item.decor().clone();
                    *item = value;
                    *item.decor_mut() = decor;
                }
            }
        }
        let mut text = document.to_string();
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
            // Of a file that the settings no longer name.
            self.trajectory.sha256.clear();
            return Ok(self);
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
            None => trajectory::built_in(&self.flight.trajectory).map_err(
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

    /// When the flight counts as tracked.
    pub const fn tracking_limits(&self) -> TrackingLimits {
        TrackingLimits {
            error_max_m: self.flight.tracking_error_max_m,
            yaw_error_max_rad: self.flight.tracking_yaw_error_max_rad,
            ground_z_m: self.flight.ground_z_m,
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
            position_error_max_m: self.flight.position_error_max_m,
            ground_z_m: self.flight.ground_z_m,
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

impl LogName {
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => ALL,
            Self::AroundMisses => AROUND_MISSES,
            Self::Off => OFF,
        }
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
