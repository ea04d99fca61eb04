//! Faults: their kinds, the filters that apply them to messages, and the text in which users write them.
//!
//! A message fault acts behind the inspection of an input ([`filter`]), and depends on the tick of the message alone. It is
//! therefore the same in processes, in one process and in replay, at any pace. Faults of parameters are changes that the
//! plant applies ([`swap`]); those of processes are done by the supervisor.
//!
//! Start with [`FAULTS`], the table of all kinds. [`grammar`] reads and prints faults, [`plan`] gives them ticks.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod code;
pub mod filter;
pub mod grammar;
mod kind;
pub mod live;
pub mod plan;
pub mod swap;

pub use kind::*;
pub use live::{MAX_MESSAGE_FAULTS, MessageFaults};
