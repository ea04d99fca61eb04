//! run.json: enough about a flight to fly it again.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::host::Host;

/// What run.json says.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFacts {
    /// Version of ironbird.
    pub version: String,
    /// Instance.
    pub instance: String,
    /// The settings that were flown, by section and key.
    pub settings: Value,
    /// The machine.
    pub host: Host,
}
