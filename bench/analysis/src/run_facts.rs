//! run.json: the settings, build and host of a flight, enough to repeat it.

use crate::host::Host;
use flight_log::build::Build;
use serde::{Deserialize, Serialize};
use serde_json::Value;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFacts {
    pub version: String,
    /// The executable; unknown in those from before builds were named.
    #[serde(default)]
    pub build: Build,
    pub instance: String,
    /// The settings that were flown, by section and key.
    pub settings: Value,
    pub host: Host,
}
