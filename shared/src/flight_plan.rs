//! What the plant's process must know of a flight besides the airframe: how long, and how fast the clock runs.

/// Length and pace of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlightPlan {
    /// Last tick to be flown; a flight has `last_tick + 1` ticks.
    pub last_tick: u64,
    /// Length of a tick on the wall clock [ns]; longer than the laws' sample time in slow motion.
    pub wall_period_ns: u64,
}
