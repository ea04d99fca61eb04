//! Sections of the report that follow from a single source each.

use std::collections::BTreeMap;

use shared::boards::{Ending, RolePhase, Status};
use shared::inspection::{REASONS, Rejections};
use shared::rt::STEPS;

use super::report::{self, Bucket, Gate};
use crate::failure::{FAILED, GATE, INTERRUPTED, OK};

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

/// Rejections by the name of their reason.
pub(super) fn rejected(rejections: &Rejections) -> BTreeMap<String, u64> {
    REASONS.iter().map(|reason| (reason.name().to_owned(), rejections.of(*reason))).collect()
}

/// What a role's status says.
pub(super) fn role_section(status: &Status) -> report::RoleSection {
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

/// A logarithmic histogram: three bars a decade.
pub(super) fn buckets(histogram: &hdrhistogram::Histogram<u64>) -> Vec<Bucket> {
    const EDGES_US: [f64; 14] = [0.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 2e3, 5e3, 1e4, 2e4, 1e5, 1e7];
    EDGES_US
        .windows(2)
        .map(|edges| {
            let (low, high) = ((edges[0] * 1e3) as u64, (edges[1] * 1e3) as u64);
            let count = histogram
                .iter_recorded()
                .filter(|value| (low..high).contains(&value.value_iterated_to()))
                .map(|value| value.count_at_value())
                .sum();
            Bucket { from_us: edges[0], below_us: edges[1], count }
        })
        .filter(|bucket| bucket.count > 0)
        .collect()
}
