//! The airframe as the controller meets it: rigid body, rotors, gyro, live parameters.
//!
//! [`plant::Plant`] is the stage that a process shell drives, one [`plant::Plant::begin`] and one
//! [`plant::Plant::finish`] per tick. The other modules are what it is made of, each a pure law or a plain
//! queue, and knows no clock, transport or operating system; the process shell is [`process`], with its [`desk`].

pub mod desk;
pub mod gyro;
pub mod integrator;
pub mod latch;
pub mod plant;
pub mod process;
pub mod rigid_body;
pub mod rotors;
pub mod swap;

pub use crate::plant::{Departure, Plant, Settings};
pub use crate::swap::{AppliedSwap, Change, Swap, SwapError};
