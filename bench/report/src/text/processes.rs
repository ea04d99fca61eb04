//! The report's part on processes: what each did, what the recorder lost, and what real time was granted.

use std::fmt::Write as _;

use super::{Written, count, lead};
use crate::losses;
use crate::schema::{Report, RoleSection};

/// What each process did, and what it was granted.
pub(super) fn table(out: &mut String, report: &Report) -> Written {
    writeln!(
        out,
        "Processes   scheduling   ticks  skipped  stale  rejected  alloc/tick  faults  preempted  cpu us/tick"
    )?;
    for (name, role) in &report.roles {
        let rejected: u64 = role.rejected.values().sum();
        let usage = role.usage.as_ref();
        let per_tick = |n: u64| n as f64 / role.ticks_run.max(1) as f64;
        let loops = name != "record";
        let word = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        writeln!(
            out,
            "  {:<9} {:<10} {:>7} {:>8} {:>6} {:>9} {:>11} {:>7} {:>10} {:>12}",
            name,
            role.scheduling,
            if loops { role.ticks_run.to_string() } else { "-".into() },
            role.ticks_skipped,
            role.ticks_stale,
            if loops { rejected } else { report.recorder.rejected.values().sum() },
            word(usage.filter(|_| loops).map(|u| format!("{:.3}", per_tick(u.allocations)))),
            word(usage.filter(|_| loops).map(|u| (u.minor_faults + u.major_faults).to_string())),
            word(usage.filter(|_| loops).map(|u| u.involuntary_switches.to_string())),
            word(usage.filter(|_| loops).map(|u| format!("{:.1}", u.cpu_per_tick_us))),
        )?;
    }
    for (name, role) in &report.roles {
        for (reason, rejected) in role.rejected.iter().filter(|(_, rejected)| **rejected > 0) {
            writeln!(out, "  {name} rejected {}: {reason}", count(*rejected, "message"))?;
        }
    }
    let recorder = &report.recorder;
    let lost = losses::lost(report);
    writeln!(
        out,
        "  recorder: lost {}, {} incomplete, {:.1} % of a processor",
        count(lost, "message"),
        count(recorder.incomplete_ticks, "tick"),
        recorder.cpu_percent
    )?;
    writeln!(out, "  {}", losses::log(&recorder.log))?;
    for (file, reason) in &recorder.unwritten {
        writeln!(out, "  {file} is incomplete: {reason}")?;
    }
    writeln!(out, "Real time asked and granted")?;
    for (name, role) in report.roles.iter().filter(|(name, _)| *name != "record") {
        writeln!(out, "  {name:<9} {}", grants(role))?;
    }
    if let Some(lead) = lead(report) {
        writeln!(out, "{lead}")?;
    }
    out.write_str(&report.interrupts.text(report.ticks.run))
}

fn grants(role: &RoleSection) -> String {
    if role.realtime.is_empty() {
        return "nothing asked: not real-time".into();
    }
    role.realtime
        .iter()
        .map(|step| {
            let asked = step.asked.map_or_else(String::new, |value| format!(" {value}"));
            match &step.refused {
                None => format!("{}{asked} ok", step.step),
                Some(reason) => format!("{}{asked} REFUSED ({reason})", step.step),
            }
        })
        .collect::<Vec<_>>()
        .join(", ")
}
