//! `ironbird doctor`: examines this machine and prints what was found.

use std::io::IsTerminal as _;
use std::time::Duration;

use clap::Args;
use failure::{Failure, GATE, OK};
use machine::Machine;
use machine::doctor::measured::MeasuredMachine;
use machine::doctor::{examine, text};
use machine::executable::own_executable;
use model::role::Role;
use report::finding::RealtimeClass;

use crate::cli::values;
use crate::output::{print, say};
use crate::settings::{Settings, check_cpu};

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
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::processor)]
    pub cpu: Option<u16>,
}

/// Examines this machine and prints what was found.
///
/// # Errors
/// Usage, where the time to measure holds no tick; [`Failure`] where the measurement failed.
pub fn doctor(args: &DoctorArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(None, &Vec::new())?;
    let priority = settings.rt.priority;
    let cpu = args.cpu.map(usize::from);
    cpu.map_or(Ok(()), |cpu| check_cpu(&format!("--cpu {cpu}"), cpu))?;
    let machine = Machine::here(priority + Role::Mixer.priority_step(), cpu);
    let executable = own_executable()?;
    let duration = Duration::try_from_secs_f64(args.seconds)
        .map_err(|e| Failure::usage(format!("--seconds {}: {e}", args.seconds)).help("for example: --seconds 5"))?;
    if std::io::stderr().is_terminal() {
        say(&format!("measuring a timer and a ring of processes, {} s each\n", args.seconds));
    }
    let examination = examine(&machine, Some(MeasuredMachine::take(&executable, duration, priority, cpu)?));
    if args.json {
        let json = serde_json::to_string_pretty(&examination).map_err(|e| Failure::failed(e.to_string()))?;
        print(&(json + "\n"))?;
    } else {
        print(&text::render(&examination))?;
    }
    Ok(if examination.diagnosis.verdict == RealtimeClass::NotRealTime { GATE } else { OK })
}
