//! Sections of the report that follow from a single source each.

use std::collections::BTreeMap;

use shared::boards::{Ending, RolePhase, Status};
use shared::inspection::{REASONS, Rejections};
use shared::rt::STEPS;

use super::report::{self, Gate};
use super::series::{Series, Statistics};
use super::theorem::Theorem;
use crate::failure::{FAILED, GATE, INTERRUPTED, OK};
use crate::log::TOPICS;
use crate::log::writer::{Counts, Fate};
use crate::settings::Settings;

/// Whether a flight passed, from its gates and how it ended; nothing while it flies.
pub(super) fn verdict(gates: Vec<Gate>, ending: Option<Ending>) -> report::Verdict {
    let held = gates.iter().all(|gate| gate.held);
    let (status, exit_code) = match ending {
        None => ("FLYING", OK),
        Some(Ending::Interrupted) => ("INTERRUPTED", INTERRUPTED),
        Some(Ending::Failed) => ("ABORTED", FAILED),
        _ if held => ("PASS", OK),
        _ => ("FAIL", GATE),
    };
    report::Verdict { status: status.into(), exit_code, gates }
}

/// What the flight must satisfy, and whether it does.
pub(super) fn gates(
    settings: &Settings,
    ticks: &report::Ticks,
    deadlines: &report::Deadlines,
    series: &[Statistics],
    theorem: &Theorem,
    ending: Option<Ending>,
) -> Vec<Gate> {
    let mut gates = vec![
        Gate {
            name: "flight envelope".into(),
            limit: format!("position error <= {} m, pitch <= 80 deg", settings.flight.position_error_max_m),
            value: ending.unwrap_or(Ending::None).words().into(),
            held: !ending.is_some_and(Ending::left_envelope),
        },
        Gate {
            name: "ticks run + skipped = elapsed / period".into(),
            limit: ticks.elapsed_periods.to_string(),
            value: (ticks.run + ticks.skipped).to_string(),
            held: ticks.identity_holds,
        },
    ];
    let ppm = settings.recorder.max_miss_rate_ppm;
    if ppm >= 0.0 {
        gates.push(Gate {
            name: "deadlines missed per million".into(),
            limit: format!("<= {ppm}"),
            value: format!("{:.1}", deadlines.missed_ppm),
            held: deadlines.missed_ppm <= ppm,
        });
    }
    let limit_us = settings.recorder.max_loop_p999_us;
    if limit_us >= 0.0 {
        let value = series.iter().find(|series| series.name == Series::Loop.name()).and_then(|s| s.p999_us);
        gates.push(Gate {
            name: "loop p99.9 [us]".into(),
            limit: format!("<= {limit_us}"),
            value: value.map_or_else(|| "too few samples".into(), |us| format!("{us:.1}")),
            held: value.is_some_and(|us| us <= limit_us),
        });
    }
    if settings.recorder.gate_theorem {
        gates.push(Gate::theorem(theorem));
    }
    gates
}

/// Rejections by the name of their reason.
pub(super) fn rejected(rejections: &Rejections) -> BTreeMap<String, u64> {
    REASONS.iter().map(|reason| (reason.name().to_owned(), rejections.of(*reason))).collect()
}

/// What a role's status says.
#[must_use]
pub fn role_section(status: &Status) -> report::RoleSection {
    let landed = status.phase() == RolePhase::Landed;
    let usage = &status.usage;
    report::RoleSection {
        ticks_run: status.ticks_run,
        ticks_skipped: status.ticks_skipped,
        ticks_stale: status.ticks_stale,
        rejected: rejected(&status.rejections),
        landed,
        usage: landed.then(|| report::Usage {
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
                report::RtStep {
                    step: serde_json::to_value(step)
                        .ok()
                        .and_then(|v| v.as_str().map(str::to_owned))
                        .unwrap_or_default(),
                    asked: (grant.value > 0 || *step == shared::rt::Step::Affinity).then_some(grant.value),
                    granted: grant.granted(),
                    refused: (!grant.granted()).then(|| grant.reason()),
                }
            })
            .collect(),
    }
}

/// What became of the messages on their way to the flight log.
pub(super) fn log_section(fate: &Fate) -> report::LogSection {
    let by_topic = |counts: &Counts| TOPICS.iter().map(|topic| (*topic).to_owned()).zip(*counts).collect();
    report::LogSection {
        file_bytes: fate.file_bytes,
        messages: by_topic(&fate.written),
        dropped: by_topic(&fate.dropped),
        refused: fate.refused.clone(),
    }
}
