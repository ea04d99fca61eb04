//! Prints the examination as text.

use std::fmt::Write as _;

use crate::doctor::Examination;
use crate::doctor::measured::{LATE_NS, MeasuredMachine};
use process::rt::WITHOUT_ROOT;
use report::finding::{Finding, Level, RealtimeClass};

#[must_use]
pub fn render(examination: &Examination) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = write(&mut out, examination);
    out
}

fn write(out: &mut String, examination: &Examination) -> std::fmt::Result {
    for finding in &examination.findings {
        write_finding(out, finding)?;
    }
    if let Some(measured) = &examination.measured {
        write_measured(out, measured)?;
    }
    let diagnosis = &examination.diagnosis;
    writeln!(out, "\nVERDICT {}", diagnosis.verdict.words())?;
    for reason in &diagnosis.reasons {
        writeln!(out, "  {reason}")?;
    }
    if diagnosis.verdict == RealtimeClass::NotRealTime {
        writeln!(out, "  {WITHOUT_ROOT}")?;
    }
    Ok(())
}

fn write_finding(out: &mut String, finding: &Finding) -> std::fmt::Result {
    writeln!(
        out,
        "{:<8} {:<17} {}",
        finding.level.word(),
        finding.subject,
        finding.found
    )?;
    if finding.level == Level::Ok {
        return Ok(());
    }
    writeln!(out, "{:>13}  {}", "why", finding.why)?;
    match &finding.fix {
        Some(fix) => writeln!(out, "{:>13}  {fix}", "fix"),
        None => Ok(()),
    }
}

fn write_measured(out: &mut String, measured: &MeasuredMachine) -> std::fmt::Result {
    writeln!(
        out,
        "\nMeasured for {} s each, {} on processor {}",
        measured.seconds, measured.scheduling, measured.cpu
    )?;
    for refused in &measured.refused {
        writeln!(out, "  refused: {refused}")?;
    }
    writeln!(
        out,
        "  [us]         count       p50       p90       p99       max   > {} us",
        LATE_NS / 1000
    )?;
    for (name, measurement) in [("timer", &measured.timer), ("ring", &measured.ring)] {
        let statistics = &measurement.statistics;
        writeln!(
            out,
            "  {name:<8} {:>9} {:>9.1} {:>9.1} {:>9.1} {:>9.1} {:>10}",
            statistics.count,
            statistics.p50_us,
            statistics.p90_us,
            statistics.p99_us,
            statistics.max_us,
            measurement.late
        )?;
    }
    writeln!(
        out,
        "  timer: how late a thread wakes on an absolute timer; ring: a lap through four processes, by futex"
    )
}
