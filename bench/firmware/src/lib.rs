//! Flight firmware as a law of the inner loop: another program, which answers each state with motor commands.
//!
//! ```text
//!   setpoint --sticks--+
//!                      +--exchange, link--> firmware --> motors --> rotor thrusts --> wrench
//!   state -------------+
//! ```
//!
//! A [`Port`] is what differs between firmwares; its [`Link`] has the packets and sockets. The rest is shared: `launch`
//! starts the program or waits for one, until it has armed; `exchange` sends, waits and counts; `bridge` is the law.
//! The program is never part of this repository (docs/firmware.md).

pub mod ardupilot;
pub mod betaflight;
pub mod bridge;
mod exchange;
mod launch;
#[cfg(feature = "mavlink")]
pub mod px4;
mod sticks;
mod udp;

use std::env;
use std::io;
use std::os::fd::BorrowedFd;
use std::time::Duration;

use control_api::description::{Description, Setting, Settings};
use control_api::law::InnerLaw;
use control_api::registry::Entry;
use ironbird_law::Measured;
use messages::content::ROTORS;
use messages::telemetry::AnswerOutcome;

use crate::bridge::{ARMING_LIMIT_S, Bridge, UDP_PORT};
use crate::sticks::Sticks;

macro_rules! firmwares {
    ($($(#[$attribute:meta])* $module:ident),+) => {
        const PORTS: &[&Port] = &[$($(#[$attribute])* &$module::PORT),+];

        /// Laws that are programs of their own.
        pub const LAWS: &[Entry<dyn InnerLaw>] = &[$(
            $(#[$attribute])*
            Entry::new(&$module::PORT.description, |rig, settings| {
                Ok(Box::new(Bridge::new(&$module::PORT, rig, settings)?))
            })
        ),+];
    };
}

firmwares!(
    ardupilot,
    betaflight,
    #[cfg(feature = "mavlink")]
    px4
);

fn port(law: &str) -> Option<&'static Port> {
    PORTS.iter().find(|it| it.description.name == law).copied()
}

/// Whether an inner law of this name is a program of its own: it cannot be copied or computed again, and one flight at
/// a time can use it.
pub fn is_program(law: &str) -> bool {
    port(law).is_some()
}

/// Longest wait until the program of a law has come and armed [s]; 0 of a law that is no program.
pub fn start_limit_s(law: &str, settings: &Settings) -> f64 {
    port(law).map_or(0.0, |port| {
        2.0 * settings.number(port.setting(&ARMING_LIMIT_S))
    })
}

/// Tells the user which firmware to start for a law; none if the rig starts it.
pub fn to_start(law: &str, settings: &Settings) -> Option<String> {
    let is_awaited = |it: &&Port| it.cached.is_none() && env::var_os(it.variable).is_none();
    let port = port(law).filter(is_awaited)?;
    let [number, limit_s] =
        [&UDP_PORT, &ARMING_LIMIT_S].map(|it| settings.number(port.setting(it)));
    Some(format!(
        "{law} waits {limit_s} s for a firmware at port {number}: start it beside the flight (`ironbird docs firmware`)"
    ))
}

/// The differences between firmwares.
#[derive(Clone, Copy, Debug)]
pub struct Port {
    pub description: Description,
    /// Environment variable that names the executable.
    pub variable: &'static str,
    /// The executable in its folder of the cache, and the files beside it of which each flight gets a copy in its working
    /// directory; none of a firmware that the user starts, if the variable is not set.
    pub cached: Option<(&'static str, &'static [&'static str])>,
    /// A firmware in lockstep takes its time from the stamps of the states and flies a mode of its own; another one has the
    /// clock of the processor, and the sticks are its command.
    pub is_lockstep: bool,
    /// Whether each state has exactly one answer, so that the next one waits for it.
    pub answers_each: bool,
    /// How many port numbers a flight takes, one after the other. The first is the flight's, the others are the firmware's.
    pub ports: u16,
    /// Opens the sockets at the first port number. Fails where another program has one of them.
    pub open: fn(u16) -> io::Result<Box<dyn Link>>,
    /// Why the firmware does not arm, in its own words, if it says so.
    pub why_not_armed: fn() -> Option<String>,
}

impl Port {
    /// Its own setting of this name, with its own default; else this one, which then has its default.
    fn setting<'a>(&'a self, setting: &'a Setting) -> &'a Setting {
        let mut own = self.description.settings.iter();
        own.find(|own| own.name == setting.name).unwrap_or(setting)
    }
}

/// A state for a firmware.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    pub stamp: Duration,
    pub measured: &'a Measured,
    pub sticks: &'a Sticks,
}

/// Motor commands, each a share of full speed, in the order of this rig's rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motors {
    pub commands: [f64; ROTORS],
    pub is_armed: bool,
    /// Rises from one answer to the next, if the firmware numbers them.
    pub number: Option<u64>,
}

/// A message of a firmware.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    Motors(Motors),
    /// Motor commands that cannot be used.
    Broken(AnswerOutcome),
    Other,
}

impl Message {
    /// Motor commands, each limited to its range; broken if one is not finite.
    pub fn motors(commands: [f64; ROTORS], is_armed: bool, number: Option<u64>) -> Self {
        match commands.iter().all(|command| command.is_finite()) {
            true => Self::Motors(Motors {
                commands: commands.map(|command| command.clamp(0.0, 1.0)),
                is_armed,
                number,
            }),
            false => Self::Broken(AnswerOutcome::NotFinite),
        }
    }
}

/// The sockets to a firmware, and its packets. Nothing of it waits, nor allocates once the firmware has sent something.
pub trait Link: Send {
    fn send(&mut self, sample: &Sample) -> io::Result<()>;

    /// The next message. An error other than [`io::ErrorKind::WouldBlock`] means that the firmware has gone.
    fn receive(&mut self) -> io::Result<Message>;

    /// Becomes readable when a message comes.
    fn descriptor(&self) -> BorrowedFd<'_>;

    fn try_clone(&self) -> io::Result<Box<dyn Link>>;
}
