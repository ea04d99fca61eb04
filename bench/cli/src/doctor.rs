//! `ironbird doctor`: examines this machine and prints the findings.

use std::io::IsTerminal as _;
use std::ops::RangeInclusive;
use std::time::Duration;

use analysis::finding::{Finding, RealtimeClass};
use errors::{Failure, GATE, OK};
use host::doctor::measured::{MeasuredMachine, TICK_NS};
use host::doctor::{examine, render};
use host::floor::timer::Schedule;
use host::{Machine, own_executable};
use messages::parameters::shown;
use messages::role::{Replica, Role};

use crate::cli::DoctorArgs;
use crate::floor::loop_cpus;
use config::{Settings, check_cpu};
use errors::output::{print, say};

/// Allowed range of `--seconds` [s]: from one tick of the measurement to an hour.
const SECONDS: RangeInclusive<f64> = 0.001..=3600.0;

pub fn doctor(args: &DoctorArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(None, &Vec::new())?;
    let priority = settings.rt.priority;
    let cpu = args.cpu.map(usize::from);
    cpu.map_or(Ok(()), |cpu| check_cpu(&format!("--cpu {cpu}"), cpu))?;
    let machine = Machine::here(priority + Replica::from(Role::Mixer).priority_step(1), cpu);
    if !SECONDS.contains(&args.seconds) {
        let (least, most, given) = (SECONDS.start(), SECONDS.end(), shown(args.seconds));
        let what = format!("--seconds {given}: allowed are {least} to {most} s");
        return Err(Failure::usage(what).help("for example: --seconds 5"));
    }
    if std::io::stderr().is_terminal() {
        let seconds = args.seconds;
        say(&format!(
            "measuring a timer, a ring of processes and flights, {seconds} s each\n"
        ));
    }
    let schedule = Schedule {
        period_ns: TICK_NS,
        duration: Duration::from_secs_f64(args.seconds),
        cpu,
        priority,
    };
    let measured = MeasuredMachine::take(&own_executable()?, &schedule)?;
    let mut examination = examine(&machine, Some(measured));
    let trials = loop_cpus::fly_each(cpu, schedule.duration);
    examination.findings.push(Finding::ok(
        "loop CPUs, flown",
        trials.map_or_else(|e| format!("not flown: {e}"), |it| loop_cpus::text(&it)),
        "stages that poll on CPUs of their own need no wake-up, but there is more that can disturb them",
    ));
    let trials = loop_cpus::fly_channels(cpu, schedule.duration);
    examination.findings.push(Finding::ok(
        "channels, flown",
        trials.map_or_else(|e| format!("not flown: {e}"), |it| loop_cpus::figures(&it)),
        "redundant channels share a CPU: their chains run one after the other in each tick",
    ));
    if args.json {
        let json = serde_json::to_string_pretty(&examination);
        print(&(json.map_err(|e| Failure::failed(e.to_string()))? + "\n"))?;
    } else {
        print(&render(&examination))?;
    }
    let is_realtime = examination.diagnosis.verdict != RealtimeClass::NotRealTime;
    Ok(if is_realtime { OK } else { GATE })
}
