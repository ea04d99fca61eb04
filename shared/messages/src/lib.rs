//! A flight as data: messages, parameters, frames, the airframe's algebra.
//!
//! It contains no middleware, no clock and no operating system. Laws, processes and reports share it. Start
//! reading in [`content`].
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod allocation;
pub mod attitude;
pub mod blackboards;
pub mod channels;
pub mod check_word;
pub mod content;
pub mod enum_registry;
pub mod fault_kinds;
pub mod fields;
pub mod flight_plan;
pub mod frames;
pub mod grid;
pub mod header;
pub mod history;
pub mod inspection;
pub mod layout;
pub mod limits;
pub mod math;
pub mod message_window;
pub mod monitor;
pub mod ned;
pub mod noise;
pub mod output_hash;
pub mod parameters;
pub mod rate_dynamics;
pub mod realtime;
pub mod rejections;
pub mod role;
pub mod settings_text;
pub mod telemetry;
pub mod topic;
pub mod vectors;
