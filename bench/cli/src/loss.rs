//! Examines why a flight was lost, in a process of its own: a law from a library may end it.

use std::path::Path;
use std::time::Duration;

use analysis::schema::LossSection;
use errors::output::print;
use errors::{Failure, OK};
use host::own_executable;
use supervisor::child_process::output_within;

/// The simulations of a flight take a fraction of its time.
const LIMIT: Duration = Duration::from_secs(60);

/// The section on the loss of a flight, by its directory.
pub fn examine(directory: &Path) -> Result<LossSection, Failure> {
    let failed = |e: std::io::Error| Failure::failed(format!("its simulation: {e}"));
    let mut command = process::signals::child(&own_executable()?, "examine-loss");
    command.arg(directory.join(flight_log::FILE));
    let output = output_within(&mut command, LIMIT).map_err(failed)?;
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| {
        let complaint = String::from_utf8_lossy(&output.stderr);
        let last = complaint.trim().lines().last().unwrap_or_default();
        Err(Failure::failed(format!(
            "its simulation ended with {}: {last}",
            output.status
        )))
    })
}

/// Prints the section on the loss of the flight of a log, or why there is none, as JSON.
pub fn print_section(log: &Path) -> Result<u8, Failure> {
    let section = replay::loss::examine(log);
    let text = serde_json::to_string(&section).map_err(|e| Failure::failed(e.to_string()))?;
    print(&(text + "\n"))?;
    Ok(OK)
}
