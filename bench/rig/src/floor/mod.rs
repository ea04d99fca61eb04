//! Measures the rig beside the machine's own limits.
//!
//! ```text
//! timer, ring, cyclictest, scalar laws --A--> pairs --> comparison --> docs/benchmarks.md
//! flights, lockstep, laws              --B-->
//! ```

pub mod beside;
pub mod calls;
pub mod command;
pub mod flight;
pub mod hop;
pub mod page;
pub mod sets;
