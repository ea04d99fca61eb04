//! Settings: defaults, preset, file, flags, in this order; checked before anything starts.

pub(crate) mod airframe;
pub mod faults;
pub mod law_settings;
mod layers;
mod processes;
mod realtime;
#[cfg(test)]
mod tests;
mod toml_access;
pub(crate) mod trajectory;
mod validation;
mod warnings;

use std::collections::BTreeMap;
use std::path::Path;

use controller::trajectory::UnknownTrajectory;
use controller::{ScaledTrajectory, Trajectory};
use flight_log::facts::{ALL, AROUND_MISSES, LogPlan, OFF};
use messages::blackboards::LOCKSTEP;
use messages::limits::RotorLimits;
use messages::role::Role;
use plant::{Ground, Initial};
use report::gates::RequestedGates;
use report::render::flight;
use report::verdicts::TrackingLimits;
use serde::{Deserialize, Serialize};

use toml::{Table, Value};

use errors::Failure;
use law_settings::Moved;
pub use layers::check_foreign_law;
use layers::{layered, read, typed};
pub use realtime::{RealtimeSection, check_cpu};
use toml_access::same;
pub use trajectory::{PointsFile, TrajectorySection};

/// The commented default, which is also where the defaults come from.
pub const DEFAULT: &str = include_str!("default.toml");

const LAWS: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];

/// Sections that all roles of a run must share.
const SHARED_SECTIONS: [&str; 11] = [
    "flight",
    "trajectory",
    "initial",
    "ground",
    "airframe",
    "plant",
    "model",
    "rotor",
    "outer",
    "inner",
    "mixer",
];

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    pub flight: FlightSettings,
    pub initial: InitialSection,
    pub ground: GroundSection,
    /// How the trajectory is stretched, and which points it has.
    #[serde(default)]
    pub trajectory: TrajectorySection,
    /// What the airframe was built with, by parameter name; the ranges of its parameters follow from it.
    #[serde(default = "airframe::paper")]
    pub airframe: BTreeMap<String, f64>,
    /// The true airframe at tick 0, by parameter name.
    pub plant: BTreeMap<String, f64>,
    /// The airframe as the laws are told that it is, by parameter name.
    pub model: BTreeMap<String, f64>,
    pub rotor: RotorLimits,
    /// The outer law, and its settings.
    pub outer: Table,
    /// The inner law, and its settings.
    pub inner: Table,
    /// The mixer's law, and its settings.
    pub mixer: Table,
    pub rt: RealtimeSection,
    /// What is recorded, and which gates the flight must pass.
    pub recorder: RecorderSettings,
    /// The points of the trajectory, where it has some.
    #[serde(skip)]
    pub points: Option<PointsFile>,
    /// Where files of laws are now.
    #[serde(skip)]
    pub moved: Moved,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightSettings {
    /// Reference trajectory: a name, or a file of points.
    pub trajectory: String,
    /// Name or file of the airframe.
    pub airframe: String,
    /// SHA-256 of the file; empty where the airframe is built in.
    #[serde(default)]
    pub airframe_sha256: String,
    /// Preset of the laws that have one of that name.
    pub preset: String,
    /// Length of the flight [s].
    pub duration_s: f64,
    /// Sample time of the laws [s].
    pub period_s: f64,
    pub pace: PaceName,
    /// Periods on the clock per tick.
    pub slowdown: u64,
    pub seed: u64,
    /// Whether an inner loop that is started again in flight begins with the last estimates, and not with its priors.
    #[serde(default)]
    pub resume_estimates: bool,
    /// What is planned to go wrong.
    pub faults: Vec<String>,
    /// Position error beyond which the flight has left its envelope [m].
    pub position_error_max_m: f64,
    /// Position error up to which its last 5 s count as tracked [m].
    pub tracking_error_max_m: f64,
    /// Angle between body z and the vertical beyond which the flight has left its envelope [rad]; pi is no limit.
    pub tilt_max_rad: f64,
    /// Height below which the airframe has hit the ground [m]; it is flown on.
    pub ground_z_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PaceName {
    Realtime,
    /// The chain itself, as fast as it can.
    Lockstep,
}

/// What is recorded, and which gates the flight must pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecorderSettings {
    /// Directory in which each flight gets one of its own.
    pub out: String,
    /// Messages that the flight log keeps.
    pub log: LogName,
    /// Flight time that it keeps before and after an event, where it keeps no more [s].
    pub log_around_s: f64,
    /// Length at which a file of it ends and the next one begins [MB].
    pub log_file_mb: u64,
    /// The newest files of it that are kept; 0 is all.
    pub log_files: u64,
    /// An interval of latency.hlog takes so long [s].
    pub hlog_every_s: u64,
    /// A row of states.csv every so many ticks.
    pub states_every_ticks: u64,
    /// Deadlines missed per million ticks that are allowed; negative is any number.
    pub max_miss_rate_ppm: f64,
    /// Ticks skipped per million that are allowed; negative is any number.
    pub max_skip_rate_ppm: f64,
    /// Ticks that a stage worked with a stale input, per million, that are allowed; negative is any number.
    pub max_stale_rate_ppm: f64,
    /// 99.9th percentile of the plant's wake-up that is allowed [us]; negative is any.
    pub max_wake_p999_us: f64,
    /// 99.9th percentile of the loop that is allowed [us]; negative is any.
    pub max_loop_p999_us: f64,
    /// Position error in the last 5 s that is allowed [m]; negative is any.
    pub max_tracking_error_m: f64,
    /// What the host may take of the loops' processor [%]; negative is any share.
    pub max_steal_percent: f64,
    /// Whether the theorem must hold: no unexplained violation, estimates live.
    pub gate_theorem: bool,
    /// Whether the kernel's trace of the loops' processor tells who ran in an outage.
    pub trace: bool,
}

/// What is set on the command line, as keys of the settings.
pub type Overrides = Vec<(&'static str, Value)>;

impl Settings {
    /// The settings that result from a file and flags.
    ///
    /// # Errors
    /// A usage [`Failure`] names the key, the value, what is allowed, and where it came from.
    pub fn resolve(file: Option<&Path>, overrides: &Overrides) -> Result<Self, Failure> {
        Self::resolve_to_make(&LAWS, file, overrides)
    }

    /// As [`Self::resolve`], for a process that makes the laws of these roles alone.
    pub fn resolve_to_make(
        makes: &[Role],
        file: Option<&Path>,
        overrides: &Overrides,
    ) -> Result<Self, Failure> {
        Self::over(
            makes,
            file.map(read).transpose()?.unwrap_or_default(),
            file,
            overrides,
        )
    }

    /// The settings that result from sections of keys, as a file would have them, and from what is said beside them.
    pub fn of(given: Table, beside: &Overrides) -> Result<Self, Failure> {
        Self::over(&LAWS, given, None, &typed(beside)?)
    }

    fn over(
        makes: &[Role],
        given: Table,
        file: Option<&Path>,
        overrides: &Overrides,
    ) -> Result<Self, Failure> {
        Self::taken(layered(given, file, overrides)?, makes).map_err(|failure| match file {
            Some(path) if !validation::is_of_flags(&failure, overrides) => {
                failure.append(&format!(" (settings file {})", path.display()))
            }
            _ => failure,
        })
    }

    /// The settings of a table that has every key.
    fn taken(table: Table, makes: &[Role]) -> Result<Self, Failure> {
        validation::check_texts("", &table)?;
        let ranges = validation::check_ranges(&table);
        let settings = table
            .try_into::<Self>()
            .map_err(|e| validation::unreadable(&e))?
            .with_points()?;
        ranges?;
        settings.check(makes).map(|()| settings)
    }

    /// The full commented settings, with these values.
    pub fn commented(&self) -> Result<String, Failure> {
        let broken = |e: String| Failure::failed(format!("the commented default is broken: {e}"));
        let mut document: toml_edit::DocumentMut =
            DEFAULT.parse().map_err(|e| broken(format!("{e}")))?;
        let mut table = Table::try_from(self).map_err(|e| broken(e.to_string()))?;
        table.remove("airframe");
        if self.flight.airframe != airframe::PAPER || self.airframe != airframe::paper() {
            document.insert(
                "airframe",
                toml_edit::Item::Table(airframe::commented(&self.airframe)),
            );
        }
        let is_laws = |section: &str| {
            law_settings::SECTIONS
                .iter()
                .any(|(name, _)| *name == section)
        };
        for (section, keys) in table.iter().filter(|(section, _)| !is_laws(section)) {
            for (key, value) in keys.as_table().into_iter().flatten() {
                let text = value.to_string();
                let value: toml_edit::Value = text
                    .parse()
                    .map_err(|e| broken(format!("{section}.{key}: {e}")))?;
                let Some(item) = document[section]
                    .get_mut(key)
                    .and_then(toml_edit::Item::as_value_mut)
                else {
                    return Err(broken(format!("{section}.{key} is not in it")));
                };
                // Where nothing was changed the text keeps the way it is written (2e-4, not 0.0002).
                if !same(item, &value) {
                    let decor = item.decor().clone();
                    *item = value;
                    *item.decor_mut() = decor;
                }
            }
        }
        let mut text = document.to_string();
        for (role, section) in self.law_sections() {
            text += &law_settings::commented(role, section, &self.moved)?;
        }
        Ok(text)
    }

    /// What all roles of a run must share: one `section.key = value` a line.
    pub fn shared_text(&self) -> Result<String, Failure> {
        let table = Table::try_from(self).map_err(|e| Failure::failed(e.to_string()))?;
        let mut text = String::new();
        for section in SHARED_SECTIONS {
            for (key, value) in table[section].as_table().into_iter().flatten() {
                text.push_str(&format!("{section}.{key} = {value}\n"));
            }
        }
        Ok(text)
    }

    pub fn course(&self) -> Result<ScaledTrajectory, Failure> {
        let TrajectorySection { size, period, .. } = self.trajectory;
        let course = match &self.points {
            Some(points) => points.course,
            None => trajectory::built_in(&self.flight.trajectory).map_err(|UnknownTrajectory(name)| {
                let names: Vec<String> = Trajectory::NAMES.iter().map(|name| format!("`{name}`")).collect();
                Failure::usage(format!(
                    "settings: unknown variant `{name}`, expected one of {}, or a CSV file, in `flight.trajectory`",
                    names.join(", ")
                ))
                .help("see `ironbird fly --print-config`")
            })?,
        };
        Ok(course.stretched(size, period))
    }

    /// The trajectory in a word, for titles.
    #[must_use]
    pub fn trajectory_name(&self) -> &str {
        last_name(&self.flight.trajectory)
    }

    #[must_use]
    pub fn airframe_name(&self) -> &str {
        last_name(&self.flight.airframe)
    }

    #[must_use]
    pub fn flown(&self) -> String {
        let airframe = flight::airframe(self.airframe_name(), &self.flight.airframe_sha256);
        flight::flown(self.trajectory_name(), &self.flight.preset, &airframe)
    }

    /// When the flight counts as tracked.
    #[must_use]
    pub const fn tracking_limits(&self) -> TrackingLimits {
        TrackingLimits {
            error_max_m: self.flight.tracking_error_max_m,
            ground_z_m: self.flight.ground_z_m,
        }
    }

    #[must_use]
    pub fn last_tick(&self) -> u64 {
        (self.flight.duration_s / self.flight.period_s).round() as u64
    }

    /// Sample time of the laws [ns].
    #[must_use]
    pub fn sample_time_ns(&self) -> u64 {
        (self.flight.period_s * 1e9).round() as u64
    }

    /// Length of a tick on the clock [ns], or [`LOCKSTEP`].
    #[must_use]
    pub fn wall_period_ns(&self) -> u64 {
        match self.flight.pace {
            PaceName::Realtime => self.sample_time_ns() * self.flight.slowdown,
            PaceName::Lockstep => LOCKSTEP,
        }
    }
}

/// The last part of a path, or a name.
pub(crate) fn last_name(path: &str) -> &str {
    path.rsplit_once('/').map_or(path, |(_, file)| file)
}

/// Messages that the flight log keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogName {
    All,
    /// Those around missed deadlines, swaps, take-off and landing.
    AroundMisses,
    Off,
}

impl LogName {
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => ALL,
            Self::AroundMisses => AROUND_MISSES,
            Self::Off => OFF,
        }
    }
}

impl Settings {
    #[must_use]
    pub fn log_plan(&self) -> LogPlan {
        let RecorderSettings {
            log,
            log_around_s,
            log_file_mb,
            log_files,
            ..
        } = self.recorder;
        let around_ticks = (log_around_s / self.flight.period_s).round() as u64;
        LogPlan {
            around_ticks: (log == LogName::AroundMisses).then_some(around_ticks),
            file_bytes: log_file_mb * 1_000_000,
            files: (log_files > 0).then_some(log_files),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialSection {
    /// Position, world frame [m].
    pub position_w_m: [f64; 3],
    /// Velocity, world frame [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Roll, pitch, yaw [rad].
    pub attitude_rad: [f64; 3],
    /// Body rates p, q, r [rad/s].
    pub rate_b_rad_s: [f64; 3],
}

impl From<&InitialSection> for Initial {
    fn from(section: &InitialSection) -> Self {
        let InitialSection {
            position_w_m,
            velocity_w_m_s,
            attitude_rad,
            rate_b_rad_s,
        } = *section;
        Self {
            position_w_m,
            velocity_w_m_s,
            attitude_rad,
            rate_b_rad_s,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundSection {
    pub contact: ContactName,
    /// From the plane of the rotors to the feet, and to the top [m].
    pub leg_m: f64,
    pub friction: f64,
    /// Fastest touch that is a landing [m/s].
    pub crash_speed_m_s: f64,
    /// Largest tilt in a touch that is a landing [rad].
    pub crash_tilt_rad: f64,
}

/// What the ground does to the airframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ContactName {
    /// Nothing: the airframe falls on, and the report says that it was below ground.
    Off,
    Plane,
}

impl GroundSection {
    /// The plane at `z_m` [m], where there is one.
    #[must_use]
    pub fn plane(&self, z_m: f64) -> Option<Ground> {
        let &Self {
            contact,
            leg_m,
            friction,
            crash_speed_m_s,
            crash_tilt_rad,
        } = self;
        let plane = Ground {
            z_m,
            leg_m,
            friction,
            crash_speed_m_s,
            crash_tilt_rad,
        };
        (contact == ContactName::Plane).then_some(plane)
    }
}

impl Settings {
    /// The gates that the flight must hold.
    #[must_use]
    pub fn gates_asked(&self) -> RequestedGates {
        let limit = |limit: f64| (limit >= 0.0).then_some(limit);
        let recorder = &self.recorder;
        RequestedGates {
            position_error_max_m: self.flight.position_error_max_m,
            ground_z_m: self.flight.ground_z_m,
            tilt_max_rad: self.flight.tilt_max_rad,
            max_miss_rate_ppm: limit(recorder.max_miss_rate_ppm),
            max_skip_rate_ppm: limit(recorder.max_skip_rate_ppm),
            max_stale_rate_ppm: limit(recorder.max_stale_rate_ppm),
            max_wake_p999_us: limit(recorder.max_wake_p999_us),
            max_loop_p999_us: limit(recorder.max_loop_p999_us),
            max_tracking_error_m: limit(recorder.max_tracking_error_m),
            max_steal_percent: limit(recorder.max_steal_percent),
            theorem: recorder.gate_theorem,
        }
    }
}
