//! The simulator: all stages of a flight in one process, tick by tick, without ports or a clock.
//!
//! It owns the closed loop ([`simulator::Simulator`]), the faults that act in it, and the timing of a recorded flight
//! ([`recorded_timing`]). It does not choose laws or settings (`config`), and does not read logs for replay (`replay`).
//! Start reading in [`simulator`]; [`simulate`] is the report of `ironbird simulate`.

pub mod expected_messages;
pub mod recorded_timing;
pub mod simulate;
pub mod simulator;
