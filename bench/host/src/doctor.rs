//! `ironbird doctor`: can this machine fly in real time, and if not, why not?
//!
//! Each subject is a pure function of a [`Machine`]. The measured part is added on request. The worst finding decides
//! the verdict.

mod clocks;
mod cpus;
mod kernel;
mod load;
pub mod measured;
mod memory;
pub mod text;

use serde::{Deserialize, Serialize};

use report::finding::{Diagnosis, Finding};
use report::host::Host;

use crate::Machine;
use crate::cpu_times::host_of;
use measured::MeasuredMachine;

/// Version of the schema of `doctor --json`: changed whenever a key changes its meaning or goes.
pub const SCHEMA: &str = "ironbird-doctor/1";

/// What was found on a machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Examination {
    /// [`SCHEMA`].
    pub schema: String,
    /// The verdict, and the findings that it is due to.
    pub diagnosis: Diagnosis,
    pub findings: Vec<Finding>,
    pub measured: Option<MeasuredMachine>,
    pub host: Host,
}

/// Everything that can be found without measuring.
#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    [
        kernel::findings,
        cpus::findings,
        clocks::findings,
        memory::findings,
        load::findings,
    ]
    .into_iter()
    .flat_map(|look| look(machine))
    .collect()
}

/// Examines a machine, and adds what was measured on it.
#[must_use]
pub fn examine(machine: &Machine, measured: Option<MeasuredMachine>) -> Examination {
    let mut findings = findings(machine);
    // Not part of `findings`: during a flight, the flight's own processes run on that CPU.
    findings.push(load::other_programs(machine));
    findings.extend(measured.iter().flat_map(MeasuredMachine::findings));
    Examination {
        schema: SCHEMA.into(),
        diagnosis: Diagnosis::of(&findings),
        findings,
        measured,
        host: host_of(machine),
    }
}
