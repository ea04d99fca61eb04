//! The flight log: every message in one MCAP file, which other tools can read too.
//!
//! ```text
//! messages --codec--> writer --chunks--> spool --> flight.mcap --> reader --> export, replay
//! ```
//!
//! Schemas, units and codec are derived from the layouts of the messages. docs/recording.md describes the file.

use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::topic::Topic;

pub mod build;
pub mod codec;
pub mod facts;
pub mod perfetto;
pub mod reader;
pub mod rows;
pub mod scene;
pub mod schema;
pub mod spool;
pub mod units;
pub mod writer;

/// Name of the log in a flight's directory.
pub const FILE: &str = "flight.mcap";

/// Topics of the loop, in the order of the data's way.
pub const TOPICS: [&str; 5] = [State::NAME, Setpoint::NAME, Wrench::NAME, RotorSpeeds::NAME, SwapRecord::NAME];
