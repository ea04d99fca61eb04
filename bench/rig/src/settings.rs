//! Settings: defaults, preset, file, flags, in this order; checked before anything starts.

pub(crate) mod airframe;
pub mod faults;
mod gates;
mod ground;
mod initial;
pub mod laws;
mod layers;
mod log;
mod mixed;
mod processes;
mod real_time;
#[cfg(test)]
mod tests;
mod told;
pub(crate) mod trajectory;
mod warnings;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

use controller::trajectory::UnknownTrajectory;
use controller::{Course, Trajectory};
use law::law::Rig;
use model::boards::LOCKSTEP;
use model::limits::RotorLimits;
use model::role::Role;
use report::text;
use report::words::TrackingLimits;
use serde::{Deserialize, Serialize};

use toml::{Table, Value};

use failure::Failure;
pub use ground::GroundSection;
pub use initial::InitialSection;
use laws::Moved;
use layers::{layered, read, same, typed};
pub use log::LogName;
pub use real_time::{RealtimeSection, check_cpu};
pub(crate) use told::last_name;
use told::{refused, within};
pub use trajectory::{PointsFile, TrajectorySection};

/// The commented default, which is also where the defaults come from.
pub const DEFAULT: &str = include_str!("default.toml");

/// Longest flight [s]: 30 days. At 1 kHz, MCAP's sequence numbers of 32 bits would start over after 49.
const LONGEST_S: f64 = 30.0 * 86_400.0;

/// The roles that have laws.
const LAWS: [Role; 3] = [Role::Outer, Role::Inner, Role::Mixer];

/// Sections that all roles of a run must share.
const SHARED_SECTIONS: [&str; 11] =
    ["flight", "trajectory", "initial", "ground", "airframe", "plant", "model", "rotor", "outer", "inner", "mixer"];

/// Everything that can be set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What to fly.
    pub flight: FlightSettings,
    /// The body at tick 0.
    pub initial: InitialSection,
    /// The ground, at `flight.ground_z_m`.
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
    /// Limits of the rotors.
    pub rotor: RotorLimits,
    /// The outer law, and its settings.
    pub outer: Table,
    /// The inner law, and its settings.
    pub inner: Table,
    /// The mixer's law, and its settings.
    pub mixer: Table,
    /// Real time.
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

/// What to fly.
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
    /// What moves the ticks on.
    pub pace: PaceName,
    /// Periods on the clock per tick.
    pub slowdown: u64,
    /// Seed of the sensors' noise.
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

/// What moves the ticks on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PaceName {
    /// The clock.
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
    ///
    /// # Errors
    /// As [`Self::resolve`].
    pub fn resolve_to_make(makes: &[Role], file: Option<&Path>, overrides: &Overrides) -> Result<Self, Failure> {
        Self::over(makes, file.map(read).transpose()?.unwrap_or_default(), file, overrides)
    }

    /// The settings that result from sections of keys, as a file would have them, and from what is said beside them.
    ///
    /// # Errors
    /// As [`Self::resolve`].
    pub fn of(given: Table, beside: &Overrides) -> Result<Self, Failure> {
        Self::over(&LAWS, given, None, &typed(beside)?)
    }

    fn over(makes: &[Role], given: Table, file: Option<&Path>, overrides: &Overrides) -> Result<Self, Failure> {
        Self::taken(layered(given, file, overrides)?, makes).map_err(|failure| match file {
            Some(path) if !told::is_of_flags(&failure, overrides) => {
                failure.append(&format!(" (settings file {})", path.display()))
            }
            _ => failure,
        })
    }

    /// The settings of a table that has every key.
    fn taken(table: Table, makes: &[Role]) -> Result<Self, Failure> {
        told::check_texts("", &table)?;
        let settings = table.try_into::<Self>().map_err(|e| told::unread(&e))?.with_points()?;
        settings.check(makes).map(|()| settings)
    }

    /// The full commented settings, with these values.
    ///
    /// # Errors
    /// [`Failure`] where the default text is broken, which a test rules out.
    pub fn commented(&self) -> Result<String, Failure> {
        let broken = |e: String| Failure::failed(format!("the commented default is broken: {e}"));
        let mut document: toml_edit::DocumentMut = DEFAULT.parse().map_err(|e| broken(format!("{e}")))?;
        let mut table = Table::try_from(self).map_err(|e| broken(e.to_string()))?;
        table.remove("airframe");
        if self.flight.airframe != airframe::PAPER || self.airframe != airframe::paper() {
            document.insert("airframe", toml_edit::Item::Table(airframe::commented(&self.airframe)));
        }
        let is_laws = |section: &str| laws::SECTIONS.iter().any(|(name, _)| *name == section);
        for (section, keys) in table.iter().filter(|(section, _)| !is_laws(section)) {
            for (key, value) in keys.as_table().into_iter().flatten() {
                let text = value.to_string();
                let value: toml_edit::Value = text.parse().map_err(|e| broken(format!("{section}.{key}: {e}")))?;
                let Some(item) = document[section].get_mut(key).and_then(toml_edit::Item::as_value_mut) else {
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
            text += &laws::commented(role, section, &self.moved)?;
        }
        Ok(text)
    }

    /// What all roles of a run must share: one `section.key = value` a line.
    ///
    /// # Errors
    /// [`Failure`] where a value cannot be written, which checked settings rule out.
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

    /// What is flown.
    ///
    /// # Errors
    /// A usage [`Failure`] names the trajectory that is unknown, which checked settings rule out.
    pub fn course(&self) -> Result<Course, Failure> {
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

    /// The airframe in a word.
    #[must_use]
    pub fn airframe_name(&self) -> &str {
        last_name(&self.flight.airframe)
    }

    /// What is flown, for titles.
    #[must_use]
    pub fn flown(&self) -> String {
        let airframe = text::airframe(self.airframe_name(), &self.flight.airframe_sha256);
        text::flown(self.trajectory_name(), &self.flight.preset, &airframe)
    }

    /// When the flight counts as tracked.
    #[must_use]
    pub const fn tracking_limits(&self) -> TrackingLimits {
        TrackingLimits { error_max_m: self.flight.tracking_error_max_m, ground_z_m: self.flight.ground_z_m }
    }

    /// Last tick of the flight.
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

    fn check(&self, makes: &[Role]) -> Result<(), Failure> {
        let flight = &self.flight;
        Rig::check_period(flight.period_s).map_err(refused)?;
        within("flight.duration_s", flight.duration_s, flight.period_s, LONGEST_S)?;
        within("flight.slowdown", flight.slowdown as f64, 1.0, 1000.0)?;
        within("flight.position_error_max_m", flight.position_error_max_m, 0.01, 1e4)?;
        within("flight.tracking_error_max_m", flight.tracking_error_max_m, 0.0, 1e4)?;
        within("flight.tilt_max_rad", flight.tilt_max_rad, 0.1, PI)?;
        within("flight.ground_z_m", flight.ground_z_m, -1e4, 0.0)?;
        within("trajectory.size", self.trajectory.size, 0.01, 100.0)?;
        within("trajectory.period", self.trajectory.period, 0.01, 100.0)?;
        within("rt.priority", f64::from(self.rt.priority), 1.0, 95.0)?;
        self.initial.check()?;
        self.ground.check()?;
        self.check_log()?;
        within("recorder.states_every_ticks", self.recorder.states_every_ticks as f64, 1.0, 1e9)?;
        self.recorder.check_gates()?;
        self.rig()?.check().map_err(refused)?;
        for (_, role) in laws::SECTIONS {
            self.check_law(role, makes)?;
        }
        if self.recorder.gate_theorem
            && let Some(law) = self.law_without_theorem()?
        {
            return Err(Failure::usage(format!(
                "recorder.gate_theorem = true: the inner law `{law}` has no theorem with these settings"
            ))
            .help("fly `adaptive` with inner.adaptation = \"on\", or without --gate theorem"));
        }
        self.check_faults()?;
        self.check_start()?;
        self.realtime()?;
        self.check_length()
    }
}
