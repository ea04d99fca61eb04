//! What a law is, and what the rig does around every law.
//!
//! A law ([`law`]) is a value of a trait, one per role: it is given the tick, what the sensors show and what is wanted,
//! and returns what to do. It knows no clock, no port and no operating system. [`description`] is what it says of
//! itself; [`registry`] is how the rig finds it by name and holds it whatever its type. [`stage`] is what a driver (a
//! role's process, a simulation, a replay) calls once per tick, with increasing ticks, of which some may be skipped:
//! messages in, a message out. [`guard`] makes a stage of any law; stale inputs and answers that are not finite are its
//! business, so that no law can forget them.

pub mod description;
pub mod guard;
pub mod law;
pub mod registry;
mod rig;
pub mod stage;

pub use guard::{GuardedInner, GuardedMixer, GuardedOuter};
pub use rig::Rig;
