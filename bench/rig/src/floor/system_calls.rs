//! System calls, allocations and page faults per tick and role, compared with the minimum.
//!
//! `strace` counts the calls of a loop's thread in the middle of a flight. The flight is in slow motion, so strace
//! makes no tick late. Each loop counts its own allocations and faults.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use ipc::instance::Instance;
use messages::role::Role;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};

use crate::floor::flight_runner::FlightRunner;
use errors::{Failure, InFile as _};
use report::schema::Report;

/// Minimum number of calls per role: one wait, and one notify if a stage follows.
const MINIMUM: [(Role, u64); 4] = [
    (Role::Plant, 2),
    (Role::Outer, 2),
    (Role::Inner, 2),
    (Role::Mixer, 1),
];
/// Calls by which a loop waits, once per tick.
const WAITS: [&str; 2] = ["clock_nanosleep", "futex(WAIT_BITSET)"];
const SLOWDOWN: u64 = 20;
const COUNTED: Duration = Duration::from_secs(4);
/// How long take-off may last.
const TAKE_OFF_TIMEOUT: Duration = Duration::from_secs(10);

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoleCalls {
    pub role: String,
    /// System calls per tick, by name.
    pub calls: BTreeMap<String, f64>,
    pub total: f64,
    /// Minimum number of calls per tick.
    pub least: u64,
    /// Only a build with the feature `instrumented` counts them.
    pub allocations: Option<f64>,
    /// Page faults in the whole flight.
    pub faults: u64,
}

#[must_use]
pub fn is_installed() -> bool {
    Command::new("strace").arg("-V").output().is_ok()
}

pub fn measure(flights: &FlightRunner) -> Result<Vec<RoleCalls>, Failure> {
    let settings = flights.directory().join("slow.toml");
    fs::write(&settings, format!("[flight]\nslowdown = {SLOWDOWN}\n"))
        .in_file("write", &settings)?;
    let text = settings.to_string_lossy();
    let (mut command, run) =
        flights.command(&["--duration", "1h", "--lead", "0", "--config", &text]);
    let mut flight = command
        .spawn()
        .map_err(|e| Failure::failed(format!("cannot launch a flight: {e}")))?;
    let counted = count(flights, &run.join("report.json"));
    if let Some(pid) = Pid::from_raw(flight.id().cast_signed()) {
        let _ = kill_process(pid, Signal::INT);
    }
    flight
        .wait()
        .map_err(|e| Failure::failed(format!("cannot wait for a flight: {e}")))?;
    let report = Report::read(&run.join("report.json"));
    let mut roles = counted?;
    let report = report?;
    for calls in &mut roles {
        if let Some((ticks, usage)) = report
            .roles
            .get(&calls.role)
            .and_then(|role| Some((role.ticks_run, role.usage.as_ref()?)))
        {
            let per_tick = |all: u64| all as f64 / ticks.max(1) as f64;
            calls.allocations = usage.allocations.map(per_tick);
            calls.faults = usage.minor_faults + usage.major_faults;
        }
    }
    Ok(roles)
}

fn count(flights: &FlightRunner, report: &std::path::Path) -> Result<Vec<RoleCalls>, Failure> {
    let is_flying =
        || Report::read(report).is_ok_and(|report| report.run.in_flight && report.ticks.run > 0);
    let mut waited = Duration::ZERO;
    while !is_flying() {
        if waited > TAKE_OFF_TIMEOUT {
            return Err(Failure::failed("a flight in slow motion did not take off"));
        }
        sleep(Duration::from_millis(100));
        waited += Duration::from_millis(100);
    }
    MINIMUM
        .into_iter()
        .map(|(role, least)| of_role(flights, role, least))
        .collect()
}

fn of_role(flights: &FlightRunner, role: Role, least: u64) -> Result<RoleCalls, Failure> {
    let instance = Instance::new(flights.instance())?;
    let pid = instance
        .pid_of(role)
        .ok_or_else(|| Failure::failed(format!("the {role} ended in the flight")))?;
    let log = flights.directory().join(format!("strace.{role}"));
    // Without -f: only the loop's thread, not the parameter server's.
    let mut strace = Command::new("strace")
        .args(["-p", &pid.to_string(), "-o"])
        .arg(&log)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| {
            Failure::failed(format!("cannot start strace: {e}")).help("apt-get install strace")
        })?;
    sleep(COUNTED);
    if let Some(pid) = Pid::from_raw(strace.id().cast_signed()) {
        let _ = kill_process(pid, Signal::INT);
    }
    strace
        .wait()
        .map_err(|e| Failure::failed(format!("cannot wait for strace: {e}")))?;
    let text = fs::read_to_string(&log).in_file("read", &log)?;
    let counts = parse(&text);
    // Without early wake-up, a loop waits once per tick: the number of waits is the number of ticks.
    let ticks = WAITS
        .iter()
        .filter_map(|name| counts.get(*name))
        .max()
        .copied()
        .unwrap_or(0);
    if ticks == 0 {
        return Err(Failure::failed(format!("strace saw no call of the {role}"))
            .help("it may need to be root, or kernel.yama.ptrace_scope = 0"));
    }
    let calls: BTreeMap<String, f64> = counts
        .into_iter()
        .map(|(name, calls)| (name, calls as f64 / ticks as f64))
        .collect();
    let total = calls.values().sum();
    Ok(RoleCalls {
        role: role.name().into(),
        calls,
        total,
        least,
        allocations: None,
        faults: 0,
    })
}

/// Counts the calls in strace's output, one per line, by name; futex calls with their operation.
fn parse(log: &str) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for name in log.lines().filter_map(name) {
        *counts.entry(name).or_insert(0) += 1;
    }
    counts
}

fn name(line: &str) -> Option<String> {
    let (name, arguments) = line.split_once('(')?;
    if name != "futex" {
        return name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
            .then(|| name.to_owned());
    }
    let operation = arguments.split(", ").nth(1)?.split('|').next()?;
    Some(format!("futex({})", operation.trim_start_matches("FUTEX_")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_counted_by_name_and_futex_calls_by_operation() {
        let log = "futex(0x7f3a, FUTEX_WAIT_BITSET, 7, {tv_sec=5, tv_nsec=1}, FUTEX_BITSET_MATCH_ANY) = 0\n\
             futex(0x7f3b, FUTEX_WAKE, 1) = 1\n\
             futex(0x7f3a, FUTEX_WAIT_BITSET|FUTEX_CLOCK_REALTIME, 8, NULL, 1) = -1 ETIMEDOUT (Connection timed out)\n\
             clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, {tv_sec=5, tv_nsec=2}, NULL) = 0\n\
             --- SIGINT {si_signo=SIGINT} ---\nstrace: Process 7 detached\n";
        let expected = [
            ("clock_nanosleep".to_owned(), 1),
            ("futex(WAIT_BITSET)".to_owned(), 2),
            ("futex(WAKE)".to_owned(), 1),
        ];
        assert_eq!(parse(log), expected.into());
    }
}
