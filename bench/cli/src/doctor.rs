//! `ironbird doctor`: examines this machine and prints the findings.

use std::io::IsTerminal as _;
use std::ops::RangeInclusive;
use std::time::Duration;

use analysis::finding::{Finding, RealtimeClass};
use errors::{Failure, GATE, OK};
use host::doctor::measured::{MeasuredMachine, TICK_NS};
use host::doctor::{examine, reason, render};
use host::floor::timer::Schedule;
use host::{Machine, own_executable};
use messages::parameters::shown;
use messages::role::{Replica, Role};

use crate::cli::DoctorArgs;
use crate::floor::loop_cpus::{Trials, fly_each, text};
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
    let mut flown = vec![flown(fly_each(cpu, schedule.duration))];
    let not_measured = |e: Failure| {
        let subject = "timer and ring";
        let finding = Finding::ok(subject, format!("not measured: {e}"), reason(subject));
        flown.push(finding.unknown(RealtimeClass::Soft));
    };
    let measured = MeasuredMachine::take(&own_executable()?, &schedule);
    let measured = measured.map_err(not_measured).ok();
    let examination = examine(&machine, measured, flown);
    if args.json {
        let json = serde_json::to_string_pretty(&examination);
        print(&(json.map_err(|e| Failure::failed(e.to_string()))? + "\n"))?;
    } else {
        print(&render(&examination))?;
    }
    let is_realtime = examination.diagnosis.verdict != RealtimeClass::NotRealTime;
    Ok(if is_realtime { OK } else { GATE })
}

/// The finding of flights; where not even the plainest one ends as it should, nothing flies in real time.
fn flown((trials, failure): Trials) -> Finding {
    let subject = "loop CPUs, flown";
    // The failure of a flight has lines.
    let ok = |found: String| Finding::ok(subject, found.replace('\n', ";"), reason(subject));
    match failure {
        None => ok(text(&trials)),
        Some(e) if trials.is_empty() => ok(format!("no flight: {e}"))
            .blocks("run `ironbird fly --duration 1s`, and do what it says"),
        Some(e) => {
            ok(format!("{}; then no flight: {e}", text(&trials))).unknown(RealtimeClass::Hard)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floor::loop_cpus::Trial;

    #[test]
    fn what_could_be_flown_in_part_is_unknown_beyond_that() {
        let trial = Trial {
            number: 1,
            loop_p99_us: 20.0,
            late: 0,
        };
        let finding = flown((vec![trial], Some(Failure::failed("why\nit ended"))));
        let found = "--loop-cpus 1 (1: loop p99 20.0 us, 0 late); then no flight: why;it ended";
        let ok = Finding::ok("loop CPUs, flown", found, reason("loop CPUs, flown"));
        assert_eq!(finding, ok.unknown(RealtimeClass::Hard));
    }
}
