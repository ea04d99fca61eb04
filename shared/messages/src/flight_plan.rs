//! What the plant needs to know of a flight: its length and the clock's speed.
//!
//! The airframe comes separately.

use crate::grid::NS_PER_S;

/// How long a process in lockstep waits for its neighbour before it gives up [ns].
pub const LOCKSTEP_PATIENCE_NS: u64 = 5 * NS_PER_S;
/// How often it looks up meanwhile, to see whether the run ends [ns].
pub const LOCKSTEP_LOOK_UP_NS: u64 = NS_PER_S / 50;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlightPlan {
    /// Last tick to be flown; a flight has `last_tick + 1` ticks.
    pub last_tick: u64,
    pub sample_time_ns: u64,
    /// Length of a tick on the wall clock [ns]; longer than the laws' sample time in slow motion, and
    /// [`crate::blackboards::LOCKSTEP`] where the chain itself moves the ticks on.
    pub wall_period_ns: u64,
}
