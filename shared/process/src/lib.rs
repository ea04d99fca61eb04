//! The process of a role: real-time set-up, take-off and landing, a stage's loop.
//!
//! Laws come in as values ([`law`]). Ports, clock and operating system stay here and in [`wire`].

pub mod lead;
pub mod rt;
pub mod session;
pub mod signals;
pub mod stage;
pub mod standby;
mod throttled_log;
