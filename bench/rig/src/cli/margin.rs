//! Flags of `margin`.

use std::path::PathBuf;
use std::time::Duration;

use campaign::gates::METRICS;
use clap::Args;
use clap::builder::PossibleValuesParser;

use crate::cli::{CourseArgs, DiffFormat, values};
use crate::margin::target;

/// Flags of `margin`.
#[derive(Clone, Debug, Args)]
pub struct MarginArgs {
    #[command(flatten)]
    #[allow(missing_docs, reason = "documented by its type")]
    pub course: CourseArgs,
    /// A law of the outer loop; may be repeated [default: pd]. Every outer law is flown with every inner law and mixer.
    #[arg(long, value_name = "LAW|FILE")]
    pub outer: Vec<String>,
    /// A law of the inner loop; may be repeated [default: adaptive].
    #[arg(long, value_name = "LAW|FILE")]
    pub inner: Vec<String>,
    /// A law of the mixer; may be repeated [default: priority].
    #[arg(long, value_name = "LAW|FILE")]
    pub mixer: Vec<String>,
    /// What counts as survived, besides the flight's envelope: recovered_below_m=0.05, recovery_max_s=3, or any other
    /// limit of a campaign's [success], of the ticks since the fault began; may be repeated.
    #[arg(long = "gate", value_name = "NAME=MOST", value_parser = gate_limit)]
    pub gates: Vec<GateLimit>,
    /// Begin faults at so many instants, spread over one period of the trajectory, or up to --duration.
    #[arg(long, value_name = "N", default_value_t = 32, allow_hyphen_values = true, value_parser = phases)]
    pub phases: u32,
    /// Measure this alone: a stage, all of them at once (machine), or the inputs of a topic; may be repeated. As with
    /// --gate and --duration, no table for reports is left then.
    #[arg(long, value_name = "WHAT", value_parser = PossibleValuesParser::new(target::names()))]
    pub only: Vec<String>,
    /// The longest outage that is tried.
    #[arg(long, value_name = "DURATION", default_value = "2s", allow_hyphen_values = true, value_parser = values::duration)]
    pub longest: Duration,
    /// Phases at once [default: one on each processor].
    #[arg(long, value_name = "N", value_parser = values::jobs)]
    pub jobs: Option<usize>,
    /// Directory of the flights whose reports are to know these margins: the table goes into DIR/margins [default: runs].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// How to print the margins.
    #[arg(long, value_enum, default_value_t = DiffFormat::Text)]
    pub format: DiffFormat,
    /// Also write the margins to this file, as a page with plots.
    #[arg(long, value_name = "FILE.html")]
    pub page: Option<PathBuf>,
}

/// A limit that a flight must hold to have survived.
#[derive(Clone, Debug, PartialEq)]
pub struct GateLimit {
    /// Its name, as in a campaign's `[success]`.
    pub name: &'static str,
    /// The most that it may be.
    pub most: f64,
}

/// The bound of a recovery, which is no metric.
pub const RECOVERED_BELOW: &str = "recovered_below_m";

/// A limit.
fn gate_limit(text: &str) -> Result<GateLimit, String> {
    let names = || METRICS.iter().map(|metric| metric.name).filter(|name| *name != "flown_s").chain([RECOVERED_BELOW]);
    let known = || names().collect::<Vec<_>>().join(", ");
    let (name, most) = text.split_once('=').ok_or_else(|| format!("write NAME=MOST; names are {}", known()))?;
    let name =
        names().find(|it| *it == name.trim()).ok_or_else(|| format!("no gate has this name; there are {}", known()))?;
    Ok(GateLimit { name, most: values::limit(most.trim())? })
}

/// A number of phases.
fn phases(text: &str) -> Result<u32, String> {
    let number = text.parse().ok().filter(|number| (1..=1000).contains(number));
    number.ok_or_else(|| "write a whole number from 1 to 1000".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gate_is_a_metric_of_campaigns_with_a_limit() {
        assert_eq!(gate_limit("recovery_max_s = 3"), Ok(GateLimit { name: "recovery_max_s", most: 3.0 }));
        assert_eq!(gate_limit("recovered_below_m=0.05"), Ok(GateLimit { name: RECOVERED_BELOW, most: 0.05 }));
        let says = |text: &str, words: &str| {
            let said = gate_limit(text).expect_err(text);
            assert!(said.contains(words), "{text}: {said}");
        };
        says("theorem", "write NAME=MOST; names are position_error_max_m, ");
        says("speed=3", "no gate has this name; there are position_error_max_m, ");
        says("flown_s=3", "no gate has this name");
        says("recovery_max_s=never", "write a number of 0 or more");
        says("recovery_max_s=-1", "write a number of 0 or more");
        assert!(phases("0").is_err() && phases("1001").is_err() && phases("x").is_err());
        assert_eq!(phases("1000"), Ok(1000));
    }
}
