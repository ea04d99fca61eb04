//! `ironbird doctor`: examines this machine and prints what was found.

use std::io::IsTerminal as _;
use std::ops::RangeInclusive;
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
    /// Measure the timer and the ring for this long each: 0.001 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, allow_hyphen_values = true)]
    pub seconds: f64,
    /// Processor of the four loops [default: the highest-numbered one].
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = values::processor)]
    pub cpu: Option<u16>,
}

/// What `--seconds` may be [s]: one tick of the measurement to an hour.
const SECONDS: RangeInclusive<f64> = 0.001..=3600.0;

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
    if !SECONDS.contains(&args.seconds) {
        let (least, most) = (SECONDS.start(), SECONDS.end());
        return Err(Failure::usage(format!("--seconds {}: allowed are {least} to {most} s", args.seconds))
            .help("for example: --seconds 5"));
    }
    let duration = Duration::from_secs_f64(args.seconds);
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
