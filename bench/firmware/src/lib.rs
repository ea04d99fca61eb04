//! Flight firmware as a law of the inner loop: another program, which answers each state with motor commands.
//!
//! ```text
//!   state, setpoint --sticks--> remote control --+
//!                                                +--exchange--> firmware --> motors --> rotor thrusts --> wrench
//!   state --port--> sensor packet ---------------+
//! ```
//!
//! A [`Port`] is what differs between firmwares: packets, port numbers, stick and motor conventions. The rest is
//! shared: [`launch`] starts, arms and ends the program, [`exchange`] sends, waits and counts, [`bridge`] is the law.
//! The program is never part of this repository; `bench/firmware/fetch` builds it (docs/firmware.md).

pub mod betaflight;
pub mod bridge;
pub mod exchange;
pub mod launch;
pub mod sticks;

use control_api::law::InnerLaw;
use control_api::registry::Entry;
use ironbird_law::Measured;
use messages::content::ROTORS;
use messages::telemetry::AnswerOutcome;

use crate::bridge::Bridge;
use crate::sticks::Sticks;

/// Laws that are programs of their own.
pub const LAWS: &[Entry<dyn InnerLaw>] = &[Entry::inner::<Bridge>()];

/// Whether an inner law of this name is a program of its own: it cannot be copied or computed again, and one flight at
/// a time can use it.
pub fn is_program(law: &str) -> bool {
    LAWS.iter().any(|it| it.description.name == law)
}

/// Longest packet [bytes].
pub const PACKET_BYTES: usize = 256;

/// A firmware's packets, port numbers, stick and motor conventions.
#[derive(Clone, Copy, Debug)]
pub struct Port {
    pub name: &'static str,
    /// Environment variable that names the executable.
    pub variable: &'static str,
    /// The executable in its folder of the cache.
    pub executable: &'static str,
    /// Files beside the executable of which each flight gets a copy in its working directory.
    pub files: &'static [&'static str],
    /// UDP ports: states and remote control to the firmware, motor commands from it.
    pub state_udp: u16,
    pub remote_udp: u16,
    pub motors_udp: u16,
    /// Writes the packet of a state at a time [s]; returns its length.
    pub state: fn(f64, &Measured, &mut [u8; PACKET_BYTES]) -> usize,
    /// Writes the packet of the remote control at a time [s]; returns its length.
    pub remote: fn(f64, &Sticks, &mut [u8; PACKET_BYTES]) -> usize,
    /// The motor commands of a packet, each a share of full speed, in the order of this rig's rotors; or why the packet
    /// cannot be used.
    pub motors: fn(&[u8]) -> Result<[f64; ROTORS], AnswerOutcome>,
    /// Why the firmware does not arm, in its own words, if it says so.
    pub why_not_armed: fn() -> Option<String>,
}
