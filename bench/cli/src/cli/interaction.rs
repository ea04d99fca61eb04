//! Flags of the commands for a running flight: `watch`, `bridge`, `inject`, `params`.

use std::net::SocketAddr;
use std::time::Duration;

use clap::{Args, Subcommand};

#[cfg(feature = "web")]
use crate::browser::open_address;
use crate::cli::values;
use errors::Failure;
#[cfg(feature = "web")]
use errors::output::say;
use faults::grammar::{Change, FaultError};
use messages::role::Channel;

#[derive(Clone, Debug, Args)]
pub struct WatchArgs {
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Print one line per second instead of the dashboard.
    #[arg(long)]
    pub plain: bool,
    /// Serve the live page to browsers on this machine, and print its address.
    #[arg(long, conflicts_with = "plain")]
    pub web: bool,
    #[command(flatten)]
    pub page: PageArgs,
    /// Let the live page change parameters, inject faults and switch channels.
    #[arg(long, requires = "web")]
    pub allow_control: bool,
    /// Open the live page in a browser: the one named by BROWSER, or the system's.
    #[arg(long, requires = "web")]
    pub open: bool,
    #[arg(from_global)]
    pub launcher: Option<u32>,
}

/// The live page of `watch` and `fly`.
#[derive(Clone, Debug, Default, Args)]
pub struct PageArgs {
    /// Port of the live page; 0 takes a free one.
    #[arg(long, value_name = "PORT", default_value_t = 0, requires = "web", allow_hyphen_values = true, value_parser = values::within(0..=u16::MAX))]
    pub port: u16,
}

impl WatchArgs {
    /// Shows a flight in the terminal or on a page.
    pub fn watch(&self) -> Result<u8, Failure> {
        match self.web {
            true => self.serve(),
            false => live::watch::watch(&self.instance, self.plain, self.launcher),
        }
    }

    #[cfg(feature = "web")]
    fn serve(&self) -> Result<u8, Failure> {
        let options = live::web::WebOptions {
            instance: self.instance.clone(),
            port: self.page.port,
            allow_control: self.allow_control,
            launched: self.launcher.is_some(),
        };
        live::web::serve(&options, |address| {
            if self.open
                && let Err(failure) = open_address(address)
            {
                say(&failure.warning());
            }
        })
    }

    #[cfg(not(feature = "web"))]
    fn serve(&self) -> Result<u8, Failure> {
        Err(
            Failure::usage("this build of ironbird has no live page (--web)")
                .help("build one that has: cargo build --release --features web"),
        )
    }
}

#[derive(Debug, Subcommand)]
pub enum BridgeTo {
    /// Serve topics, a 3-D scene and the airframe's parameters over the Foxglove WebSocket protocol. Requires a build
    /// with `--features foxglove`.
    Foxglove(FoxgloveArgs),
    /// Report to a ground station as a MAVLink vehicle: telemetry, events, and the airframe's parameters.
    #[command(after_help = "\
Examples:
  ironbird bridge mavlink                           report to a ground station on this machine
  ironbird bridge mavlink --tcp 127.0.0.1:5760      wait for a ground station that connects
  ironbird bridge mavlink --allow-control           let it change parameters and inject failures")]
    Mavlink(MavlinkArgs),
}

#[derive(Clone, Debug, Args)]
pub struct MavlinkArgs {
    /// Address of the ground station.
    #[arg(
        long,
        value_name = "ADDR:PORT",
        default_value = "127.0.0.1:14550",
        value_parser = values::address,
        conflicts_with = "tcp"
    )]
    pub udp: SocketAddr,
    /// Wait at this address of this machine for a ground station that connects, instead; port 0 takes a free one.
    #[arg(long, value_name = "ADDR:PORT", value_parser = values::address)]
    pub tcp: Option<SocketAddr>,
    /// Let the ground station change parameters and inject failures.
    #[arg(long)]
    pub allow_control: bool,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    #[arg(from_global)]
    pub launcher: Option<u32>,
}

impl MavlinkArgs {
    #[cfg(feature = "mavlink")]
    pub fn serve(&self) -> Result<u8, Failure> {
        use live::vehicle::{Address, VehicleOptions};
        live::vehicle::serve(&VehicleOptions {
            instance: self.instance.clone(),
            address: self.tcp.map_or(Address::Udp(self.udp), Address::Tcp),
            allow_control: self.allow_control,
            launched: self.launcher.is_some(),
        })
    }

    #[cfg(not(feature = "mavlink"))]
    pub fn serve(&self) -> Result<u8, Failure> {
        Err(
            Failure::usage("this build of ironbird has no bridge to MAVLink")
                .help("build one that has: cargo build --release --features mavlink"),
        )
    }
}

#[derive(Clone, Debug, Args)]
pub struct FoxgloveArgs {
    /// Let every client that reaches the address change parameters and inject faults.
    #[arg(long)]
    pub allow_swaps: bool,
    /// Also accept web pages from this origin, for example `https://studio.example`; may be repeated. Pages from
    /// app.foxglove.dev and this machine, and clients that are not browsers, are always accepted.
    #[arg(long, value_name = "ORIGIN", value_parser = values::origin)]
    pub allow_origin: Vec<String>,
    /// Address to listen on.
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    pub host: String,
    /// Port to listen on; 0 takes a free one.
    #[arg(long, value_name = "PORT", default_value_t = 8765, allow_hyphen_values = true, value_parser = values::within(0..=u16::MAX))]
    pub port: u16,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

#[cfg(feature = "foxglove")]
impl FoxgloveArgs {
    pub fn options(&self) -> live::bridge::FoxgloveOptions {
        live::bridge::FoxgloveOptions {
            instance: self.instance.clone(),
            host: self.host.clone(),
            port: self.port,
            allow_swaps: self.allow_swaps,
            allow_origin: self.allow_origin.clone(),
        }
    }
}

#[derive(Clone, Debug, Args)]
pub struct InjectArgs {
    /// What to change, with the syntax of --fault. Parameters: NAME=VALUE, where VALUE is a number, `nominal`, or +30% of
    /// nominal; ~2s after it makes a 2 s ramp. Faults of messages, stages and the CPU: for example state.drop=0.1, ended by
    /// state.drop=off. `ironbird params` and `ironbird faults` list what can be changed.
    #[arg(required = true, value_name = "WHAT[=VALUE]")]
    pub changes: Vec<String>,
    /// Apply at this tick of the flight.
    #[arg(long, value_name = "N", conflicts_with = "after", allow_hyphen_values = true, value_parser = values::tick)]
    pub at_tick: Option<u64>,
    /// How long a fault lasts, for example 1s; without it, until it is ended. Parameters keep their value.
    #[arg(long = "for", value_name = "TIME", allow_hyphen_values = true, value_parser = values::duration)]
    pub lasts: Option<Duration>,
    /// Apply after this much flight time, for example 500ms.
    #[arg(long = "in", value_name = "TIME", allow_hyphen_values = true, value_parser = values::duration)]
    pub after: Option<Duration>,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

#[derive(Clone, Debug, Args)]
pub struct SwitchArgs {
    /// The channel whose laws are to fly: a, b or c.
    #[arg(long, value_name = "LETTER", value_parser = values::channel)]
    pub to: Channel,
    /// Switch at this tick of the flight.
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::tick)]
    pub at_tick: Option<u64>,
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

impl From<SwitchArgs> for InjectArgs {
    fn from(args: SwitchArgs) -> Self {
        Self {
            changes: vec![format!("{}.switch", args.to)],
            at_tick: args.at_tick,
            lasts: None,
            after: None,
            instance: args.instance,
        }
    }
}

impl InjectArgs {
    /// The changes, as far as they can be read without an airframe.
    pub fn parsed(&self) -> Result<Vec<Change>, FaultError> {
        self.changes
            .iter()
            .flat_map(|text| text.split(','))
            .map(str::parse)
            .collect()
    }
}

#[derive(Clone, Debug, Args)]
pub struct ParamsArgs {
    /// Name of the instance.
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Airframe whose ranges and nominal values to list [default: that of the flight, or paper].
    #[arg(long, value_name = "NAME|FILE.toml")]
    pub airframe: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
