//! Flags of the gates that a flight must hold.

use clap::{Args, ValueEnum};
use toml::Value;

use crate::cli::values;
use crate::settings::Overrides;

/// Gates: what does not hold, or measured nothing, ends the flight with exit code 3.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Gates: exit code 3 where one does not hold, or measured nothing")]
pub struct GateArgs {
    /// Deadlines missed per million ticks at the most.
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_miss_rate: Option<f64>,
    /// Ticks skipped per million at the most.
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_skip_rate: Option<f64>,
    /// Ticks that a stage worked with a stale input, per million at the most.
    #[arg(long, value_name = "PPM", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_stale_rate: Option<f64>,
    /// 99.9th percentile of the plant's wake-up, from the beginning of the tick, at the most [us].
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_wake_p999: Option<f64>,
    /// 99.9th percentile of the loop at the most [us].
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_loop_p999: Option<f64>,
    /// Position error in the last 5 s at the most [m].
    #[arg(long, value_name = "M", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_tracking_error: Option<f64>,
    /// Share of the loops' processor that the host may steal at the most [%].
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true, value_parser = values::limit)]
    pub max_steal: Option<f64>,
    /// What must hold; may be repeated.
    #[arg(long = "gate", value_enum, value_name = "GATE")]
    pub gates: Vec<GateName>,
}

/// A gate that holds or not, without a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GateName {
    /// No unexplained violation of the theorem, and estimates that move as predicted.
    Theorem,
}

impl GateArgs {
    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let limits = [
            ("recorder.max_miss_rate_ppm", self.max_miss_rate),
            ("recorder.max_skip_rate_ppm", self.max_skip_rate),
            ("recorder.max_stale_rate_ppm", self.max_stale_rate),
            ("recorder.max_wake_p999_us", self.max_wake_p999),
            ("recorder.max_loop_p999_us", self.max_loop_p999),
            ("recorder.max_tracking_error_m", self.max_tracking_error),
            ("recorder.max_steal_percent", self.max_steal),
        ];
        let limits = limits.into_iter().filter_map(|(key, limit)| Some((key, Value::from(limit?))));
        limits.chain(named(&self.gates)).collect()
    }
}

/// What gates set that have no number.
pub(super) fn named(gates: &[GateName]) -> Overrides {
    gates
        .iter()
        .map(|gate| match gate {
            GateName::Theorem => ("recorder.gate_theorem", Value::from(true)),
        })
        .collect()
}
