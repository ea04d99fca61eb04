//! The machine as seen through /proc, /sys and a few system calls.
//!
//! Code that draws conclusions takes a [`Machine`], so a test can make one up: a directory in place of `/`, and
//! prepared answers in place of the system calls.

mod control_group;
pub mod cpu_times;
pub mod doctor;
pub mod floor;
mod hypervisor;
pub mod interrupts;
mod machine;
pub mod sampler;
pub mod trace;

use std::path::PathBuf;

use errors::Failure;

pub use machine::*;

/// The executable of this process, which every other process of the rig runs too.
pub fn own_executable() -> Result<PathBuf, Failure> {
    std::env::current_exe()
        .map_err(|e| Failure::failed(format!("cannot find the own executable: {e}")))
}
