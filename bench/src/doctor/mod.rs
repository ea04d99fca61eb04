//! `ironbird doctor`: can this machine fly in real time, and if not, what is in the way?
//!
//! Each subject is a pure function of a [`Machine`]; the measured part is added where it was asked for. The verdict
//! is the worst that any finding leaves open.

mod clocks;
mod cpus;
pub mod finding;
mod kernel;
mod load;
pub mod measured;
mod memory;
mod text;

use std::io::IsTerminal as _;
use std::time::Duration;

use clap::Args;
use serde::{Deserialize, Serialize};
use shared::role::Role;

use crate::failure::{Failure, GATE, OK};
use crate::fly::own_executable;
use crate::machine::Machine;
use crate::output::print;
use crate::record::host::Host;
use crate::settings::Settings;
use finding::{Diagnosis, Finding, Verdict};
use measured::Measured;

/// Version of the schema of `doctor --json`: changed whenever a key changes its meaning or goes.
pub const SCHEMA: &str = "ironbird-doctor/1";

/// Flags of `doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Measure the timer and the ring for this long each.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    pub seconds: f64,
    /// Processor of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N")]
    pub cpu: Option<u16>,
}

/// What was found on a machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Examination {
    /// [`SCHEMA`].
    pub schema: String,
    /// The verdict, and the findings that it is due to.
    pub diagnosis: Diagnosis,
    /// Everything that was looked at.
    pub findings: Vec<Finding>,
    /// What was measured.
    pub measured: Option<Measured>,
    /// The machine.
    pub host: Host,
}

/// Everything that can be found without measuring.
#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    [kernel::findings, cpus::findings, clocks::findings, memory::findings, load::findings]
        .into_iter()
        .flat_map(|look| look(machine))
        .collect()
}

/// Examines a machine, and adds what was measured on it.
#[must_use]
pub fn examine(machine: &Machine, measured: Option<Measured>) -> Examination {
    let mut findings = findings(machine);
    findings.extend(measured.iter().flat_map(Measured::findings));
    Examination {
        schema: SCHEMA.into(),
        diagnosis: Diagnosis::of(&findings),
        findings,
        measured,
        host: Host::of(machine),
    }
}

/// Examines this machine and prints what was found.
///
/// # Errors
/// Usage, where the time to measure holds no tick; [`Failure`] where the measurement failed.
pub fn doctor(args: &DoctorArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(None, &Vec::new())?;
    let priority = settings.rt.priority;
    let cpu = args.cpu.map(usize::from);
    let machine = Machine::here(priority + Role::Mixer.priority_step(), cpu);
    let executable = own_executable()?;
    let duration = Duration::try_from_secs_f64(args.seconds)
        .map_err(|e| Failure::usage(format!("--seconds {}: {e}", args.seconds)).help("for example: --seconds 5"))?;
    if std::io::stderr().is_terminal() {
        eprintln!("measuring a timer and a ring of processes, {} s each", args.seconds);
    }
    let examination = examine(&machine, Some(Measured::take(&executable, duration, priority, cpu)?));
    if args.json {
        let json = serde_json::to_string_pretty(&examination).map_err(|e| Failure::failed(e.to_string()))?;
        print(&(json + "\n"))?;
    } else {
        print(&text::render(&examination))?;
    }
    Ok(if examination.diagnosis.verdict == Verdict::NotRealTime { GATE } else { OK })
}
