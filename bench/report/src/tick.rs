//! One tick of a flight with every message sent in it.

use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;

/// What the stages told each other at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickRecord {
    /// The tick.
    pub tick: u64,
    /// State at the tick.
    pub state: State,
    /// Set-point computed from it, if the outer loop gave one.
    pub setpoint: Option<Setpoint>,
    /// Thrust and torque demanded.
    pub wrench: Wrench,
    /// Command that is in force from the next tick on.
    pub rotor_speeds: RotorSpeeds,
    /// What is said of the theorem, if somebody watches it.
    pub monitor: Option<Monitor>,
}
