//! The flight log: every message of a flight in one MCAP file, which other tools read too.
//!
//! ```text
//! messages --codec--> writer --chunks--> spool --> flight.mcap --> reader --> export, replay
//! ```
//!
//! Schemas, units and codec follow from the layouts of the messages; docs/recording.md describes the file.

use std::path::{Path, PathBuf};

use shared::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use shared::topic::Topic;

use crate::failure::Failure;
use crate::run_directory;

pub mod codec;
pub mod export;
pub mod facts;
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

/// The log of a flight: of its directory, of `latest`, or the file itself.
///
/// # Errors
/// Usage, where there is no such flight or it has no log.
pub fn find(run: &Path, out: Option<&Path>) -> Result<PathBuf, Failure> {
    if run.is_file() {
        return Ok(run.to_owned());
    }
    let directory = run_directory::find(run, out)?;
    let path = directory.join(FILE);
    if path.is_file() {
        return Ok(path);
    }
    let mut there: Vec<String> = std::fs::read_dir(&directory)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
        .collect();
    there.sort();
    Err(Failure::usage(format!("{} holds no {FILE}; it holds: {}", directory.display(), there.join(", ")))
        .help("name a flight that has one, or the file itself; flights of earlier versions have none"))
}
