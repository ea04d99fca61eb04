//! Findings about time: the clock source, timers, and how precise the kernel is.

use crate::{CLOCK_SOURCE, Machine};
use report::finding::Finding;

#[must_use]
pub fn findings(machine: &Machine) -> Vec<Finding> {
    vec![clock(machine), timers(machine), slack(machine)]
}

fn clock(machine: &Machine) -> Finding {
    let why = "every stamp reads it: some sources take a system call or an access to a slow device each time";
    let source = machine.clock_source();
    let finding = Finding::ok("clock", source.as_str(), why);
    let available = machine
        .read("/sys/devices/system/clocksource/clocksource0/available_clocksource")
        .unwrap_or_default();
    let fix = if available.split(' ').any(|other| other == "tsc") {
        format!("echo tsc | sudo tee {CLOCK_SOURCE}")
    } else {
        "boot with tsc=reliable, where the processor's counter is constant (constant_tsc, nonstop_tsc)".into()
    };
    match source.as_str() {
        "jiffies" | "refined-jiffies" => finding.blocks(fix),
        "hpet" | "acpi_pm" | "pit" => finding.softens(fix),
        _ => finding,
    }
}

fn timers(machine: &Machine) -> Finding {
    let why =
        "without high-resolution timers a wake-up comes with the scheduler's tick, 1 to 10 ms late";
    let resolution_ns = machine.answers.timer_resolution_ns;
    let finding = Finding::ok("timers", format!("resolution {resolution_ns} ns"), why);
    // A timer without high resolution has that of the scheduler's tick: at best a millisecond.
    if resolution_ns < 100_000 {
        finding
    } else {
        finding.blocks("boot a kernel with CONFIG_HIGH_RES_TIMERS=y, without highres=off")
    }
}

fn slack(machine: &Machine) -> Finding {
    let why =
        "timers of SCHED_OTHER fire late by it, so that several fire together; SCHED_FIFO has none";
    let found = match machine.number("/proc/self/timerslack_ns") {
        Some(ns) => format!("{} us by default; the loops ask for 1 ns", ns / 1000),
        None => "unknown; the loops ask for 1 ns".into(),
    };
    Finding::ok("timer slack", found, why)
}
