//! The process of a role: real-time set-up, take-off and landing, a stage's loop.
//!
//! Laws come in as values ([`law`]). Ports, clock and operating system stay here and in [`wire`].

pub mod farewell;
pub mod launcher;
pub mod lead;
mod patience;
pub mod quantile;
pub mod rt;
pub mod shell;
pub mod signals;
pub mod spare;
pub mod stage;
pub mod station;
pub mod stop;
