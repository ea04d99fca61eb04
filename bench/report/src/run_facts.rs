//! run.json: enough about a flight to fly it again.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use flight_log::build::Build;

use crate::host::Host;

/// What run.json says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFacts {
    /// Version of ironbird.
    pub version: String,
    /// The executable; unknown in those from before builds were named.
    #[serde(default)]
    pub build: Build,
    /// Instance.
    pub instance: String,
    /// The settings that were flown, by section and key.
    pub settings: Value,
    /// The machine.
    pub host: Host,
}
