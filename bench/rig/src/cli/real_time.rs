//! Flags of real time.

use clap::{Args, ValueEnum};
use toml::Value;

use crate::cli::{name_of, values};
use crate::settings::{Overrides, PaceName, Settings};
use failure::Failure;

/// How to run it in real time.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Real time")]
pub struct RtArgs {
    /// Whether to insist on real time [default: prefer].
    #[arg(long, value_enum)]
    pub rt: Option<RtMode>,
    /// What advances the ticks [default: realtime].
    #[arg(long, value_enum)]
    pub pace: Option<PaceArg>,
    /// Processor of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::processor)]
    pub cpu: Option<u16>,
    /// How far ahead of its tick the plant's timer is set: microseconds, or auto [default: auto].
    ///
    /// The plant waits out the rest by reading the clock. auto measures this machine before take-off, and follows the
    /// flight; without SCHED_FIFO it is 0, which is no lead.
    #[arg(long, value_name = "US", allow_hyphen_values = true, value_parser = values::lead)]
    pub lead: Option<LeadArg>,
    /// Whether the stages rehearse their tick in the lead [default: true].
    #[arg(long, value_name = "BOOL")]
    pub rehearse: Option<bool>,
    /// Name of the instance; several fly side by side.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Whether to insist on real time.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RtMode {
    /// End with exit code 4 when SCHED_FIFO, locked memory or anything else that is needed is refused.
    Require,
    /// Fly with what is granted, and say what was not.
    Prefer,
    /// Ask for nothing.
    Off,
}

/// What advances the ticks.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PaceArg {
    /// The clock: a tick a millisecond, whoever is ready for it.
    Realtime,
    /// The chain itself: the next tick begins when the rotor command has arrived; not real-time.
    Lockstep,
}

/// How far ahead of its tick the plant's timer is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeadArg {
    /// As a measurement before take-off says.
    Auto,
    /// So many microseconds.
    Us(u32),
}

/// Refuses a flag in lockstep.
pub(super) fn on_the_clock(flag: &str, settings: &Settings) -> Result<(), Failure> {
    match settings.flight.pace {
        PaceName::Realtime => Ok(()),
        PaceName::Lockstep => {
            Err(Failure::usage(format!("{flag} has no meaning in lockstep, where no clock moves the ticks"))
                .help(format!("leave {flag} out, or fly on the clock: --pace realtime")))
        }
    }
}

impl RtArgs {
    /// Refuses flags that only mean something on the clock, where a flight is in lockstep: they would be dropped.
    ///
    /// # Errors
    /// A usage [`Failure`] names the flag.
    pub fn check(&self, settings: &Settings) -> Result<(), Failure> {
        let asks = self.rt.is_some_and(|mode| !matches!(mode, RtMode::Off));
        let given = [
            ("--rt", asks),
            ("--cpu", self.cpu.is_some()),
            ("--lead", self.lead.is_some()),
            ("--rehearse", self.rehearse.is_some()),
        ];
        given.into_iter().filter(|(_, is_given)| *is_given).try_for_each(|(flag, _)| on_the_clock(flag, settings))
    }

    /// What the flags set.
    #[must_use]
    pub fn overrides(&self) -> Overrides {
        let mut set = Overrides::new();
        if let Some(mode) = self.rt {
            set.push(("rt.mode", Value::from(name_of(mode))));
        }
        if let Some(pace) = self.pace {
            set.push(("flight.pace", Value::from(name_of(pace))));
        }
        if let Some(cpu) = self.cpu {
            set.push(("rt.cpu", Value::from(i64::from(cpu))));
        }
        if let Some(lead) = self.lead {
            let value = match lead {
                LeadArg::Auto => Value::from("auto"),
                LeadArg::Us(us) => Value::from(i64::from(us)),
            };
            set.push(("rt.lead_us", value));
        }
        if let Some(rehearse) = self.rehearse {
            set.push(("rt.rehearse", Value::from(rehearse)));
        }
        set
    }
}
