//! The executable of this process, which every other process of the rig runs too.

use std::path::PathBuf;

use errors::Failure;

/// Where the executable of this process is.
pub fn own_executable() -> Result<PathBuf, Failure> {
    std::env::current_exe()
        .map_err(|e| Failure::failed(format!("cannot find the own executable: {e}")))
}
