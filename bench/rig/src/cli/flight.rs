//! Flags that say what to fly, and by which laws.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use toml::Value;

use crate::cli::values;
use crate::fault::Fault;
use crate::settings::Overrides;

/// What to fly, by whichever laws.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct CourseArgs {
    /// Reference trajectory, or a CSV file of points with the columns t,x,y,z,yaw [default: lissajous].
    #[arg(long, value_parser = values::TrajectoryParser)]
    pub trajectory: Option<String>,
    /// Airframe: paper, crazyflie, x500, or an airframe file [default: paper].
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub airframe: Option<String>,
    /// Preset of the laws that have one of that name [default: flight].
    #[arg(long, value_parser = values::PresetParser)]
    pub preset: Option<String>,
    /// Length of the flight, as in 30s or 2m [default: 30s; of margin a period of the trajectory].
    #[arg(long, allow_hyphen_values = true, value_parser = values::duration)]
    pub duration: Option<Duration>,
    /// Seed of the sensors' noise [default: 1].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::seed)]
    pub seed: Option<i64>,
    /// Settings file (TOML); flags override it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Something that goes wrong: 'WHAT=VALUE[,WHAT=VALUE]@8s' or '...@tick8000', ..9s behind it for an end; may be
    /// repeated. A parameter's value is a number, nominal, or +30% of nominal; ~2s behind it goes there in 2 s.
    /// `ironbird params` and `ironbird faults` list what there is.
    #[arg(long = "fault", value_name = "FAULT", value_parser = values::fault)]
    pub faults: Vec<Fault>,
}

/// What to fly, and by which laws.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Flight")]
pub struct FlightArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub course: CourseArgs,
    /// Law of the outer loop [default: pd]: a name of `ironbird laws`, or the file of a law, as ./libmy.so.
    #[arg(long, value_name = "LAW|FILE")]
    pub outer: Option<String>,
    /// Law of the inner loop [default: adaptive].
    #[arg(long, value_name = "LAW|FILE")]
    pub inner: Option<String>,
    /// Law of the mixer [default: priority].
    #[arg(long, value_name = "LAW|FILE")]
    pub mixer: Option<String>,
    /// An inner loop that is started again in flight begins with the last estimates, not with its priors.
    #[arg(long)]
    pub resume_estimates: bool,
}

impl CourseArgs {
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
        if let Some(seed) = self.seed {
            set.push(("flight.seed", Value::from(seed)));
        }
        if !self.faults.is_empty() {
            set.push(("flight.faults", Value::from(self.faults.iter().map(Fault::to_string).collect::<Vec<_>>())));
        }
        set
    }
}

impl FlightArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let laws = [("outer.law", &self.outer), ("inner.law", &self.inner), ("mixer.law", &self.mixer)];
        let laws = laws.into_iter().filter_map(|(key, name)| Some((key, Value::from(name.clone()?))));
        let resumed = self.resume_estimates.then(|| ("flight.resume_estimates", Value::from(true)));
        self.course.overrides().into_iter().chain(laws).chain(resumed).collect()
    }
}
