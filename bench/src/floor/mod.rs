//! The machine's own limits, without the rig, and how far the rig is from them.
//!
//! ```text
//! timer, ring, cyclictest, scalar laws --A--> pairs --> comparison --> docs/benchmarks.md
//! flights, lockstep, laws              --B-->
//! ```

pub mod beside;
pub mod calls;
pub mod command;
pub mod comparison;
pub mod cyclictest;
pub mod flight;
pub mod hop;
pub mod link;
pub mod metronome;
pub mod page;
pub mod ring;
pub mod scalar;
pub mod sets;
pub mod timer;
pub mod work;
