//! The airframe as the controller meets it: body, rotors, ground, sensors, live parameters.
//!
//! [`plant::Plant`] is the stage: the process calls [`plant::Plant::begin`] and [`plant::Plant::finish`] once per
//! tick. The other modules are its parts. Each is a pure law or a plain queue and knows no clock, transport or
//! operating system. Feature `process` adds the plant's process, in
//! module `process`.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod command_delay;
pub mod command_hold;
pub mod envelope_violation;
pub mod ground;
pub mod guidance;
pub mod integrator;
pub mod noise;
pub mod plant;
#[cfg(feature = "process")]
pub mod process;
pub mod rigid_body;
pub mod rotors;
pub mod sensors;
pub mod settings;
pub mod turbulence;

pub use crate::envelope_violation::{Crash, EnvelopeViolation};
pub use crate::ground::Ground;
pub use crate::plant::Plant;
pub use crate::settings::{Initial, PlantSettings};
pub use faults::swap::{self, AppliedSwap, Swap, SwapError, Target};
