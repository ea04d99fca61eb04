//! What every process of ironbird needs: messages, parameters, frames, wire, clock, real-time set-up.
//!
//! Laws use [`messages`], [`parameters`], [`limits`], [`frames`], [`allocation`] and [`rate_dynamics`]; process
//! shells use the rest.

pub mod allocation;
pub mod boards;
pub mod clock;
pub mod envelope;
pub mod error;
pub mod flight_plan;
pub mod frames;
pub mod inspection;
pub mod instance;
pub mod launcher;
pub mod layout;
pub mod limits;
pub mod messages;
pub mod monitor;
pub mod parameters;
mod patience;
pub mod rate_dynamics;
pub mod role;
pub mod rt;
pub mod settings_text;
pub mod stage;
pub mod station;
pub mod topic;
pub mod wire;
