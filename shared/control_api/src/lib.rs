//! What a law is, and what the rig does around every law.
//!
//! A law ([`law`]) is a value of a trait, one per role. It gets the tick, the measurement and the setpoint, and returns
//! its output. It knows no clock, no port and no operating system. [`description`] holds its name, settings and signals;
//! [`registry`] lists laws by name. [`guard`] wraps a law into a stage and adds the fallbacks: messages in, a message out. A driver (a role's process, a simulation, a replay) calls it once per tick, with increasing ticks, of which some
//! may be skipped. The guard handles stale inputs and outputs that are not finite, so that no law can forget them.
//! [`saved_state`] holds what a law and its guard remember, for another instance to continue from.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod description;
pub mod guard;
pub mod law;
pub mod registry;
mod rig;
pub mod saved_state;

pub use guard::{GuardedInner, GuardedMixer, GuardedOuter};
pub use rig::{PERIODS_S, Rig};
pub use saved_state::{SAVED_STATE_BYTES, SavedState};
