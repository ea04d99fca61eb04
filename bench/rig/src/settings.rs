//! Settings: defaults, preset, file, flags, in this order; checked before anything starts.

pub(crate) mod airframe;
mod gates;
mod ground;
mod initial;
mod layers;
mod log;
mod processes;
mod real_time;
#[cfg(test)]
mod tests;
pub(crate) mod trajectory;
mod warnings;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

use controller::trajectory::UnknownTrajectory;
use controller::{Course, Gains, Limits, Preset, Trajectory};
use model::boards::LOCKSTEP;
use model::limits::RotorLimits;
use plant::Swap;
use report::words::TrackingLimits;
use serde::{Deserialize, Serialize};

use toml::{Table, Value};

use crate::fault::Fault;
use failure::Failure;
pub use ground::GroundSection;
pub use initial::InitialSection;
use layers::{layered, same};
pub use log::LogName;
pub use real_time::{RealtimeSection, check_cpu};
pub use trajectory::{PointsFile, TrajectorySection};

/// The commented default, which is also where the defaults come from.
pub const DEFAULT: &str = include_str!("default.toml");

/// Longest flight [s]: 30 days. At 1 kHz, MCAP's sequence numbers of 32 bits would start over after 49.
const LONGEST_S: f64 = 30.0 * 86_400.0;

/// Sections that all roles of a run must share.
const SHARED_SECTIONS: [&str; 10] =
    ["flight", "trajectory", "initial", "ground", "airframe", "plant", "model", "gains", "limits", "rotor"];

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
    /// The airframe as the controller believes it to be, by parameter name.
    pub model: BTreeMap<String, f64>,
    /// Gains of both loops.
    pub gains: Gains,
    /// Limits of the outer loop.
    pub limits: Limits,
    /// Limits of the rotors.
    pub rotor: RotorLimits,
    /// Real time.
    pub rt: RealtimeSection,
    /// What is recorded, and which gates the flight must pass.
    pub recorder: RecorderSettings,
    /// The points of the trajectory, where it has some.
    #[serde(skip)]
    pub points: Option<PointsFile>,
}

/// What to fly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightSettings {
    /// Reference trajectory: a name, or a file of points.
    pub trajectory: String,
    /// Name or file of the airframe.
    pub airframe: String,
    /// Set of gains.
    pub preset: Preset,
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
    /// Swaps known before the flight.
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
        let (table, origin) = layered(file, overrides)?;
        table
            .try_into()
            .map_err(|e: toml::de::Error| {
                // The second line names the key.
                let what = e.to_string().trim_end().replace('\n', " ");
                Failure::usage(format!("settings: {what}")).help("see `ironbird fly --print-config`")
            })
            .and_then(Self::with_points)
            .and_then(|settings: Self| settings.check().map(|()| settings))
            .map_err(|failure| match origin {
                Some(path) => failure.append(&format!(" (settings file {})", path.display())),
                None => failure,
            })
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
        for (section, keys) in &table {
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
        Ok(document.to_string())
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

    /// The settings with the points that their trajectory names, if it is a file.
    fn with_points(mut self) -> Result<Self, Failure> {
        if !trajectory::is_file(&self.flight.trajectory) {
            return Ok(self);
        }
        // Where the roles of a flight stand in different folders, they mean the same file.
        if let Ok(path) = Path::new(&self.flight.trajectory).canonicalize() {
            self.flight.trajectory = path.to_string_lossy().into_owned();
        }
        let read = PointsFile::read(&self.flight.trajectory)?;
        self.take_points(read)?;
        Ok(self)
    }

    /// Takes the points of the trajectory, if they are those that the settings have the hash of.
    ///
    /// # Errors
    /// A usage [`Failure`] names both hashes.
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
        match self.flight.trajectory.rsplit_once('/') {
            Some((_, file)) => file,
            None => &self.flight.trajectory,
        }
    }

    /// When the flight counts as tracked.
    #[must_use]
    pub const fn tracking_limits(&self) -> TrackingLimits {
        TrackingLimits { error_max_m: self.flight.tracking_error_max_m, ground_z_m: self.flight.ground_z_m }
    }

    /// Swaps known before the flight.
    ///
    /// # Errors
    /// A usage [`Failure`] quotes the fault and says what is wrong with it.
    pub fn faults(&self) -> Result<Vec<Swap>, Failure> {
        let airframe = self.airframe()?;
        self.flight
            .faults
            .iter()
            .map(|text| text.parse::<Fault>()?.swap(self.flight.period_s, &airframe))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| {
                let list = format!("`ironbird params --airframe {}`", self.flight.airframe);
                let list = if self.flight.airframe == airframe::PAPER { "`ironbird params`".into() } else { list };
                Failure::usage(format!("fault: {e} ({list} lists names, units and ranges)"))
            })
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

    fn check(&self) -> Result<(), Failure> {
        let flight = &self.flight;
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
        let refused = |e: controller::SettingsError| {
            Failure::usage(format!("settings: {e}")).help("see `ironbird fly --print-config`")
        };
        self.controller()?.check().map_err(refused)?;
        let faults = self.faults()?;
        if faults.len() > plant::swap::PENDING_SWAPS {
            return Err(Failure::usage(format!(
                "flight.faults has {} entries: allowed are {}",
                faults.len(),
                plant::swap::PENDING_SWAPS
            ))
            .help("put values that change at the same instant into one fault: NAME=VALUE,NAME=VALUE@8s"));
        }
        if let Some(late) = faults.iter().find(|fault| fault.tick > self.last_tick()) {
            return Err(Failure::usage(format!(
                "a fault at tick {} never strikes: the flight ends at tick {}",
                late.tick,
                self.last_tick()
            ))
            .help("fly longer (--duration), or strike earlier"));
        }
        self.check_start()?;
        self.realtime()?;
        Ok(())
    }
}

fn within(key: &str, value: f64, min: f64, max: f64) -> Result<(), Failure> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(Failure::usage(format!("{key} = {value} is out of range: allowed are {min} to {max}"))
            .help("`ironbird fly --print-config` explains every setting"))
    }
}
