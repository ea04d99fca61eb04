//! Flags of the commands for a flight in the air: watch, bridge, inject, params.

use std::time::Duration;

use clap::{Args, Subcommand};

use crate::cli::values;
use crate::fault::{Change, FaultError};

/// Flags of `watch`.
#[derive(Clone, Debug, Args)]
pub struct WatchArgs {
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Print a line per second, as where there is no terminal.
    #[arg(long)]
    pub plain: bool,
    /// End with the flight, and with the process of this number, which must be the parent; Ctrl-C goes to it.
    #[arg(long, hide = true)]
    pub launcher: Option<u32>,
}

/// Protocols of other programs.
#[derive(Debug, Subcommand)]
pub enum BridgeTo {
    /// Foxglove WebSocket: topics, the 3-D scene, and the airframe's parameters. Only in a build with `--features
    /// foxglove`.
    Foxglove(FoxgloveArgs),
}

/// Flags of `bridge foxglove`.
#[derive(Clone, Debug, Args)]
pub struct FoxgloveArgs {
    /// Let clients swap parameters and inject faults from the panel: anyone who reaches the address.
    #[arg(long)]
    pub allow_swaps: bool,
    /// Let in pages of this origin too, as in `https://studio.example`; may be repeated. Those of app.foxglove.dev and
    /// of this machine are let in, and whatever is no browser's page.
    #[arg(long, value_name = "ORIGIN", value_parser = values::origin)]
    pub allow_origin: Vec<String>,
    /// Address to listen on.
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    pub host: String,
    /// Port to listen on; 0 takes one that is free.
    #[arg(long, value_name = "PORT", default_value_t = 8765)]
    pub port: u16,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Flags of `inject`.
#[derive(Clone, Debug, Args)]
pub struct InjectArgs {
    /// What goes wrong from one tick on, in the words of --fault. New values of parameters, NAME=VALUE...: a number,
    /// nominal, or +30% of nominal; ~2s behind it goes there in 2 s. Or faults of messages, stages and their processor,
    /// as in state.drop=0.1, which state.drop=off ends; `ironbird faults` lists them.
    #[arg(required = true, value_name = "WHAT[=VALUE]")]
    pub changes: Vec<String>,
    /// Apply at this tick of the flight.
    #[arg(long, value_name = "N", conflicts_with = "after", allow_hyphen_values = true, value_parser = values::tick)]
    pub at_tick: Option<u64>,
    /// How long a fault lasts, as in 1s; without it for good, or once. A parameter holds until it is changed again.
    #[arg(long = "for", value_name = "TIME", allow_hyphen_values = true, value_parser = values::duration)]
    pub lasts: Option<Duration>,
    /// Apply this much flight time later, as in 500ms.
    #[arg(long = "in", value_name = "TIME", allow_hyphen_values = true, value_parser = values::duration)]
    pub after: Option<Duration>,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Flags of `params`.
#[derive(Clone, Debug, Args)]
pub struct ParamsArgs {
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Airframe whose ranges and nominal values are listed [default: that of the flight, or paper].
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub airframe: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl InjectArgs {
    /// The changes, as far as they can be read without an airframe.
    ///
    /// # Errors
    /// [`FaultError`] names what is wrong with one.
    pub fn parsed(&self) -> Result<Vec<Change>, FaultError> {
        self.changes.iter().flat_map(|text| text.split(',')).map(str::parse).collect()
    }
}
