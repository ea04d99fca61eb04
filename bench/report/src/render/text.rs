//! The report of a flight as text, section by section.

use crate::phrase::count;
use crate::render::{baseline_text, facts_text, failure_text};
use crate::schema::TimingVerdict;
use crate::schema::{Report, RoleSection, RunSection};
use crate::series::Statistics;
use crate::speed::Speed;
use crate::swaps::AppliedSwap;
use crate::{margin_section as margin, message_loss};
use std::fmt::{Display, Write as _};

/// Prints a section of the report.
type Section = fn(&mut String, &Report) -> Written;

/// The sections of the report, by name, in order.
const SECTIONS: [(&str, Section); 11] = [
    ("head", head),
    ("deadlines", ticks),
    ("outages", outages),
    ("deaths", |out, report| {
        out.write_str(&failure_text::text(report))
    }),
    ("latencies", latencies),
    ("floors", floors),
    ("processes", processes),
    ("tracking", flight),
    ("telemetry", |out, report| {
        out.write_str(&facts_text::telemetry(&report.run.laws))
    }),
    ("theorem", |out, report| {
        out.write_str(&report.theorem.text())
    }),
    ("gates", gates),
];

/// Names of the sections, in order.
pub const SECTION_NAMES: [&str; SECTIONS.len()] = {
    let mut names = [""; SECTIONS.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = SECTIONS[i].0;
        i += 1;
    }
    names
};

/// Renders the whole report for people.
#[must_use]
pub fn render(report: &Report) -> String {
    SECTION_NAMES.map(|name| section(report, name)).join("\n")
}

/// Renders the section of a name.
#[must_use]
pub fn section(report: &Report, name: &str) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = SECTIONS
        .iter()
        .filter(|(it, _)| *it == name)
        .try_for_each(|(_, write)| write(&mut out, report));
    out.trim_start_matches('\n').to_owned()
}

/// What was flown, in the words of all that is said of a flight; `airframe` as of [`airframe`].
#[must_use]
pub fn flown(trajectory: impl Display, preset: impl Display, airframe: &str) -> String {
    let airframe = if airframe.is_empty() {
        String::new()
    } else {
        format!(", airframe {airframe}")
    };
    format!("trajectory {trajectory}, gains {preset}{airframe}")
}

/// An airframe in a word: its name, and of a file also the begin of its SHA-256.
#[must_use]
pub fn airframe(name: &str, sha256: &str) -> String {
    match sha256.get(..12) {
        Some(begin) => format!("{name} (sha256 {begin})"),
        None => name.to_owned(),
    }
}

impl RunSection {
    /// What was flown; reports from before airframes were named have none.
    #[must_use]
    pub fn flown(&self) -> String {
        flown(
            &self.trajectory,
            &self.preset,
            &airframe(&self.airframe, &self.airframe_sha256),
        )
    }
}

#[must_use]
pub fn title(run: &RunSection) -> String {
    format!("{}, {}", run.flown(), run.started)
}

/// The one parseable last line of a flight.
#[must_use]
pub fn result_line(report: &Report, directory: &str) -> String {
    let percentile = |name: &str, pick: fn(&Statistics) -> Option<f64>| {
        report
            .series(name)
            .and_then(pick)
            .map_or_else(|| "none".into(), |us| format!("{us:.1}"))
    };
    let rt = report
        .roles
        .get("plant")
        .map_or_else(|| "other".into(), |plant| plant.scheduling.replace(' ', ""));
    let (held, asked) = report.verdict.asked();
    [
        format!(
            "RESULT status={} gates={held}/{asked} {}",
            report.verdict.status,
            report.words.pairs()
        ),
        format!(
            "ticks={} skipped={} misses={}",
            report.ticks.run, report.ticks.skipped, report.deadlines.missed
        ),
        format!("loop_p50_us={}", percentile("loop", |s| Some(s.p50_us))),
        format!("loop_p999_us={}", percentile("loop", |s| s.p999_us)),
        format!(
            "wake_p99_us={}",
            percentile("wake.plant", |s| Some(s.p99_us))
        ),
        format!("rt={rt} steal={:.2}", report.steal.percent),
        format!(
            "deaths={}",
            report.deaths.len() as u64 + report.deaths_left_out
        ),
        format!(
            "lost={} unlogged={}",
            message_loss::lost(report),
            message_loss::unlogged(report)
        ),
        format!("build={} run={directory}", report.run.build.token()),
    ]
    .join(" ")
}

type Written = std::fmt::Result;

fn head(out: &mut String, report: &Report) -> Written {
    write!(out, "{}", report.words)?;
    let run = &report.run;
    writeln!(
        out,
        "ironbird {}  {}  instance {}  {}",
        run.build.of_version(&run.version),
        run.started,
        run.instance,
        ending(report)
    )?;
    writeln!(out, "{}", pace(report))?;
    if !run.laws.is_empty() {
        writeln!(out, "laws {}", facts_text::laws(&run.laws))?;
    }
    writeln!(out, "{}", machine(report))?;
    writeln!(
        out,
        "clock {}, sched_rt_runtime_us {}, stolen by the host during the flight {} ms ({:.2} % of {})",
        report.host.clock_source,
        report.host.rt_runtime_us,
        report.steal.stolen_ms,
        report.steal.percent,
        report.steal.processors()
    )?;
    writeln!(out, "real time here: {}", here(report))?;
    message_loss::sentences(report)
        .iter()
        .try_for_each(|sentence| writeln!(out, "{sentence}"))?;
    if !run.last_words.is_empty() {
        writeln!(out, "\nLast messages of the process")?;
    }
    run.last_words
        .iter()
        .try_for_each(|line| writeln!(out, "  {line}"))
}

/// How it ended, where it has.
pub fn ending(report: &Report) -> &str {
    if report.run.in_flight {
        "IN FLIGHT, numbers so far"
    } else {
        &report.run.ending
    }
}

/// What the flight says of real time on this machine, and what the doctor expects of it.
#[must_use]
pub fn here(report: &Report) -> String {
    let (doctor, timing) = (&report.doctor, &report.words.timing);
    let reasons = if doctor.reasons.is_empty() {
        String::new()
    } else {
        format!(" ({})", doctor.reasons.join("; "))
    };
    let expected = format!("{}{reasons}", doctor.verdict.words());
    match timing.word {
        TimingVerdict::InTime => expected,
        TimingVerdict::Late => format!(
            "not in this flight: {}; by its set-up {expected}",
            timing.why
        ),
        TimingVerdict::CutShort => format!("{expected}; {}", timing.why),
        TimingVerdict::NotMeasured => {
            format!("not measured: {}; by its set-up {expected}", timing.why)
        }
    }
}

#[must_use]
pub fn machine(report: &Report) -> String {
    let host = &report.host;
    format!(
        "{} ({}), {} x {}{}",
        host.kernel,
        host.preemption,
        host.cpus,
        host.cpu,
        host.below()
    )
}

/// What was flown, and how fast.
#[must_use]
pub fn pace(report: &Report) -> String {
    let run = &report.run;
    let pace = match run.speed() {
        Speed::Lockstep => {
            format!(
                ", in lockstep{}: its latencies are not real-time latencies",
                times_real_time(report)
            )
        }
        speed => speed
            .why_not_real_time()
            .map_or_else(String::new, |why| format!(", {why}")),
    };
    format!("{}, T = {:.0} us{pace}", run.flown(), run.period_us)
}

/// How the plant's timer was set; in lockstep there is none.
#[must_use]
pub fn lead(report: &Report) -> Option<String> {
    (report.run.speed() != Speed::Lockstep).then(|| report.lead.text(report.ticks.run))
}

/// How much faster than the clock a flight in lockstep was.
fn times_real_time(report: &Report) -> String {
    let flown_s = (report.ticks.run + report.ticks.skipped) as f64 * report.run.period_us / 1e6;
    if report.ticks.elapsed_s > 0.0 {
        format!(
            " at {:.1} times real time",
            flown_s / report.ticks.elapsed_s
        )
    } else {
        String::new()
    }
}

fn ticks(out: &mut String, report: &Report) -> Written {
    let ticks = &report.ticks;
    writeln!(
        out,
        "Ticks     run {} + skipped {} = {} {} elapsed {:.3} s / period = {}",
        ticks.run,
        ticks.skipped,
        ticks.run + ticks.skipped,
        if ticks.identity_holds { "=" } else { "IS NOT" },
        ticks.elapsed_s,
        ticks.elapsed_periods
    )?;
    let deadlines = &report.deadlines;
    if let Some(not_fresh) = &deadlines.not_fresh {
        writeln!(
            out,
            "Commands  {} ticks without a fresh one on time ({:.1} per million): {}",
            not_fresh.ticks,
            not_fresh.per_million,
            not_fresh.parts()
        )?;
    }
    writeln!(
        out,
        "Deadlines missed {} ({:.1} per million); late by their stamps {}",
        deadlines.missed, deadlines.missed_ppm, deadlines.missed_by_stamps
    )?;
    let most = deadlines
        .late
        .iter()
        .map(|bucket| bucket.count)
        .max()
        .unwrap_or(1)
        .max(1);
    for bucket in &deadlines.late {
        let bar = "#".repeat((bucket.count * 40).div_ceil(most) as usize);
        writeln!(
            out,
            "  late {:>8} .. {:<8} us {:>7}  {bar}",
            bucket.from_us, bucket.below_us, bucket.count
        )?;
    }
    for run in &deadlines.runs {
        writeln!(
            out,
            "  in a row {:>4} {:>21}",
            run.length_ticks,
            count(run.count, "time")
        )?;
    }
    Ok(())
}

fn outages(out: &mut String, report: &Report) -> Written {
    let text = report.autopsy.text();
    margin::sentence(report)
        .iter()
        .try_for_each(|sentence| writeln!(out, "Margin    {sentence}"))?;
    if report.run.speed() == Speed::Lockstep {
        writeln!(
            out,
            "Outages   not looked for: in lockstep there are no deadlines"
        )
    } else if text.is_empty() {
        writeln!(out, "Outages   none")
    } else {
        out.write_str(&text)
    }
}

fn floors(out: &mut String, report: &Report) -> Written {
    match &report.beside {
        Some(beside) => out.write_str(&baseline_text::section(beside, report)),
        None => writeln!(
            out,
            "Floors    not measured: `ironbird fly --floor 11s` does so after the flight"
        ),
    }
}

fn latencies(out: &mut String, report: &Report) -> Written {
    writeln!(
        out,
        "Latencies [us]          count       p50       p90       p99     p99.9    p99.99       max"
    )?;
    for series in &report.series {
        let rare = |value: Option<f64>| value.map_or_else(|| "-".into(), |us| format!("{us:.1}"));
        writeln!(
            out,
            "  {:<18} {:>10} {:>9.1} {:>9.1} {:>9.1} {:>9} {:>9} {:>9.1}",
            series.name,
            series.count,
            series.p50_us,
            series.p90_us,
            series.p99_us,
            rare(series.p999_us),
            rare(series.p9999_us),
            series.max_us
        )?;
    }
    writeln!(
        out,
        "  -: too few values. On a shared machine the maximum mostly shows the host. No sample was discarded."
    )
}

fn flight(out: &mut String, report: &Report) -> Written {
    let flight = &report.flight;
    writeln!(
        out,
        "Tracking  position error rms {:.4} m, largest {:.4} m, at the end {:.4} m, over {}{}",
        flight.position_error_rms_m,
        flight.position_error_max_m,
        flight.position_error_final_m,
        count(flight.states, "state"),
        without_state(report)
    )?;
    writeln!(
        out,
        "  rotors saturated in {}",
        count(flight.saturated_ticks, "tick")
    )?;
    if let Some(e) = flight.rate_error_final_rad_s {
        writeln!(
            out,
            "  rate error of the inner law at the end {e:.3e} rad/s"
        )?;
    }
    for estimate in &flight.estimates {
        writeln!(
            out,
            "  {:<24} estimated {:>12.6e}  true {:>12.6e}",
            estimate.name, estimate.estimated, estimate.actual
        )?;
    }
    for swap in &report.swaps {
        let AppliedSwap {
            parameter_epoch,
            tick,
            time_s,
            ..
        } = swap;
        writeln!(
            out,
            "  swap {parameter_epoch} at tick {tick} ({time_s:.3} s): {}",
            swap.words()
        )?;
    }
    if report.swaps_left_out > 0 {
        writeln!(out, "  and {} later ones", report.swaps_left_out)?;
    }
    for fault in &report.faults {
        writeln!(out, "  fault {}", fault.words())?;
    }
    Ok(())
}

/// How many ticks no position error is known of.
#[must_use]
pub fn without_state(report: &Report) -> String {
    match report.flight.ticks_without_state {
        0 => String::new(),
        1 => "; 1 tick has none".into(),
        ticks => format!("; {ticks} ticks without one"),
    }
}

fn gates(out: &mut String, report: &Report) -> Written {
    writeln!(out, "Gates     {}", report.verdict.words())?;
    report
        .verdict
        .gates
        .iter()
        .try_for_each(|gate| writeln!(out, "  {gate}"))
}

/// What each process did, and what it was granted.
fn processes(out: &mut String, report: &Report) -> Written {
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
            if loops {
                role.ticks_run.to_string()
            } else {
                "-".into()
            },
            role.ticks_skipped,
            role.ticks_stale,
            if loops {
                rejected
            } else {
                report.recorder.rejected.values().sum()
            },
            word(
                usage
                    .filter(|_| loops)
                    .and_then(|u| u.allocations)
                    .map(|all| format!("{:.3}", per_tick(all)))
            ),
            word(
                usage
                    .filter(|_| loops)
                    .map(|u| (u.minor_faults + u.major_faults).to_string())
            ),
            word(
                usage
                    .filter(|_| loops)
                    .map(|u| u.involuntary_switches.to_string())
            ),
            word(
                usage
                    .filter(|_| loops)
                    .map(|u| format!("{:.1}", u.cpu_per_tick_us))
            ),
        )?;
    }
    for (name, role) in &report.roles {
        for (reason, rejected) in role.rejected.iter().filter(|(_, rejected)| **rejected > 0) {
            writeln!(
                out,
                "  {name} rejected {}: {reason}",
                count(*rejected, "message")
            )?;
        }
    }
    let recorder = &report.recorder;
    let lost = message_loss::lost(report);
    writeln!(
        out,
        "  recorder: lost {}, {} incomplete, {:.1} % of a processor",
        count(lost, "message"),
        count(recorder.incomplete_ticks, "tick"),
        recorder.cpu_percent
    )?;
    writeln!(out, "  {}", facts_text::log(&recorder.log))?;
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
            let asked = step
                .asked
                .map_or_else(String::new, |value| format!(" {value}"));
            match &step.refused {
                None => format!("{}{asked} ok", step.step),
                Some(reason) => format!("{}{asked} REFUSED ({reason})", step.step),
            }
        })
        .collect::<Vec<_>>()
        .join(", ")
}
