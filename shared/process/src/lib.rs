//! The process of a role: real-time set-up, take-off and landing, a stage's loop.
//!
//! Laws come in as values (`control_api::guard`). Real-time set-up is in [`rt`], start and end in [`session`], the loop
//! in [`stage`]. Ports come from the crate `ipc`. Start reading in [`stage::run`].

pub mod lead;
pub mod rt;
pub mod session;
pub mod signals;
pub mod stage;
mod throttled_log;
pub mod wakes;
