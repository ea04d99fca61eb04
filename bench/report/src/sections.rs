//! Sections of the report that each follow from a single source.

use std::collections::BTreeMap;

use model::boards::{Ending, RolePhase, Status};
use model::inspection::{REASONS, Rejections};
use model::realtime::STEPS;

use crate::losses::{self, INCOMPLETE};
use crate::schema::{self, Gate, Report};
use crate::tally::series::{Series, Statistics};
use crate::tally::theorem::Theorem;
use failure::{FAILED, GATE, INTERRUPTED, OK, errno_text};
use flight_log::TOPICS;
use flight_log::entry::Counts;
use flight_log::writer::Fate;

/// Status of a flight that held its gates and was recorded whole.
const PASS: &str = "PASS";

/// Whether a flight passed, from its gates, the messages that were lost, and how it ended; nothing while it flies.
pub fn verdict(gates: Vec<Gate>, lost: u64, ending: Option<Ending>) -> schema::FlightVerdict {
    let held = gates.iter().all(|gate| gate.held);
    let (status, exit_code) = match ending {
        None => ("FLYING", OK),
        Some(Ending::Interrupted) => ("INTERRUPTED", INTERRUPTED),
        Some(Ending::Failed) => ("ABORTED", FAILED),
        _ if held && lost > 0 => (INCOMPLETE, OK),
        _ if held => (PASS, OK),
        _ => ("FAIL", GATE),
    };
    schema::FlightVerdict { status: status.into(), exit_code, gates }
}

/// The gates that a flight was asked to pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GatesAsked {
    /// Distance from the reference beyond which a flight ends [m].
    pub position_error_max_m: f64,
    /// Deadlines missed per million at the most.
    pub max_miss_rate_ppm: Option<f64>,
    /// 99.9th percentile of the loop at the most [us].
    pub max_loop_p999_us: Option<f64>,
    /// The theorem must hold.
    pub theorem: bool,
}

/// Gates that need no message, of every flight.
const FROM_COUNTERS: usize = 2;

/// Name of the gate that every flight has.
const ENVELOPE: &str = "flight envelope";

/// What is known of the envelope, by how the flight ended; none while it flies.
const fn envelope(ending: Option<Ending>) -> &'static str {
    match ending {
        None => "not left so far",
        Some(ending) if ending.left_envelope() => ending.words(),
        Some(Ending::Completed) => "not left",
        Some(_) => "not left until the end of the record",
    }
}

/// Ends the report of a flight in the air, whose recorder will not do so.
pub fn break_off(report: &mut Report, status: &str, exit_code: u8, ending: String) {
    if report.run.in_flight {
        let left = report.verdict.gates.iter_mut().filter(|gate| gate.name == ENVELOPE);
        left.for_each(|gate| gate.value = envelope(Some(Ending::None)).into());
    }
    (report.verdict.status, report.verdict.exit_code) = (status.into(), exit_code);
    (report.run.ending, report.run.in_flight) = (ending, false);
}

/// What the flight must satisfy, and whether it does.
pub fn gates(
    asked: &GatesAsked,
    ticks: &schema::Ticks,
    deadlines: &schema::DeadlineSection,
    series: &[Statistics],
    theorem: &Theorem,
    lost: u64,
    ending: Option<Ending>,
) -> Vec<Gate> {
    let mut gates = vec![
        Gate {
            name: ENVELOPE.into(),
            limit: format!("position error <= {} m, pitch <= 80 deg", asked.position_error_max_m),
            value: envelope(ending).into(),
            held: !ending.is_some_and(Ending::left_envelope),
        },
        Gate {
            name: "ticks run + skipped = elapsed / period".into(),
            limit: ticks.elapsed_periods.to_string(),
            value: (ticks.run + ticks.skipped).to_string(),
            held: ticks.identity_holds,
        },
    ];
    if let Some(ppm) = asked.max_miss_rate_ppm {
        gates.push(Gate {
            name: "deadlines missed per million".into(),
            limit: format!("<= {ppm}"),
            value: format!("{:.1}", deadlines.missed_ppm),
            held: deadlines.missed_ppm <= ppm,
        });
    }
    if let Some(limit_us) = asked.max_loop_p999_us {
        let value = series.iter().find(|series| series.name == Series::Loop.name()).and_then(|s| s.p999_us);
        gates.push(Gate {
            name: "loop p99.9 [us]".into(),
            limit: format!("<= {limit_us}"),
            value: value.map_or_else(|| "too few samples".into(), |us| format!("{us:.1}")),
            held: value.is_some_and(|us| us <= limit_us),
        });
    }
    if asked.theorem {
        gates.push(Gate::theorem(theorem));
    }
    // The plant counts its ticks and deadlines itself; what is measured from messages tells nothing of those lost.
    for gate in
        gates.iter_mut().skip(FROM_COUNTERS + usize::from(asked.max_miss_rate_ppm.is_some())).filter(|_| lost > 0)
    {
        gate.held = false;
        gate.value += &format!(", and {lost} messages were not seen");
    }
    gates
}

/// Rejections by the name of their reason.
pub fn rejected(rejections: &Rejections) -> BTreeMap<String, u64> {
    REASONS.iter().map(|reason| (reason.name().to_owned(), rejections.of(*reason))).collect()
}

/// What a role's status says.
#[must_use]
pub fn role_section(status: &Status) -> schema::RoleSection {
    let landed = status.phase() == RolePhase::Landed;
    let usage = &status.usage;
    schema::RoleSection {
        ticks_run: status.ticks_run,
        ticks_skipped: status.ticks_skipped,
        ticks_stale: status.ticks_stale,
        rejected: rejected(&status.rejections),
        landed,
        usage: landed.then(|| schema::LoopUsage {
            allocations: usage.allocations,
            minor_faults: usage.minor_faults,
            major_faults: usage.major_faults,
            voluntary_switches: usage.voluntary_switches,
            involuntary_switches: usage.involuntary_switches,
            cpu_per_tick_us: usage.cpu_ns as f64 / 1e3 / status.ticks_run.max(1) as f64,
        }),
        scheduling: if status.grants.policy == 1 { format!("fifo {}", status.grants.priority) } else { "other".into() },
        realtime: STEPS
            .iter()
            .filter(|step| status.grants.of(**step).asked == 1)
            .map(|step| {
                let grant = status.grants.of(*step);
                schema::RtStep {
                    step: serde_json::to_value(step)
                        .ok()
                        .and_then(|v| v.as_str().map(str::to_owned))
                        .unwrap_or_default(),
                    asked: (grant.value > 0 || *step == model::realtime::RealtimeStep::Affinity).then_some(grant.value),
                    granted: grant.granted(),
                    refused: (!grant.granted()).then(|| errno_text(grant.errno)),
                }
            })
            .collect(),
    }
}

/// Puts in what became of the messages on their way to the flight log. A flight that lacks some is no plain PASS.
pub fn take_log(report: &mut Report, kept: &str, fate: &Fate) {
    report.recorder.log = log_section(kept, fate);
    if losses::unlogged(report) > 0 && report.verdict.status == PASS {
        report.verdict.status = INCOMPLETE.into();
    }
}

/// What became of the messages on their way to the flight log, which keeps `kept`.
pub fn log_section(kept: &str, fate: &Fate) -> schema::LogSection {
    let by_topic = |counts: &Counts| TOPICS.iter().map(|topic| (*topic).to_owned()).zip(*counts).collect();
    schema::LogSection {
        kept: kept.into(),
        files: fate.files,
        file_bytes: fate.file_bytes,
        messages: by_topic(&fate.written),
        dropped: by_topic(&fate.dropped),
        left_out: by_topic(&fate.left_out),
        removed: by_topic(&fate.removed),
        stretches: fate.stretches,
        refused: fate.refused.clone(),
    }
}
