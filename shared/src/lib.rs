//! What every process of ironbird needs: messages, parameters, frames, wire, clock, real-time set-up.
//!
//! Laws use [`messages`], [`parameters`], [`frames`], [`allocation`] and [`rate_dynamics`]; process shells use the rest.

pub mod allocation;
pub mod frames;
pub mod messages;
pub mod parameters;
pub mod rate_dynamics;
