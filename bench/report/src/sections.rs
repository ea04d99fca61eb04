//! Sections of the report that follow from one status board or one log.

use crate::schema;
use errors::errno_text;
use flight_log::TOPICS;
use flight_log::entry::Counts;
use flight_log::writer::Fate;
use messages::blackboards::{RolePhase, Status};
use messages::inspection::{REASONS, Rejections};
use messages::realtime::STEPS;
use std::collections::BTreeMap;

/// Rejections by the name of their reason.
pub fn rejected(rejections: &Rejections) -> BTreeMap<String, u64> {
    REASONS
        .iter()
        .map(|reason| (reason.name().to_owned(), rejections.of(*reason)))
        .collect()
}

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
            allocations: usage.counted_allocations(),
            minor_faults: usage.minor_faults,
            major_faults: usage.major_faults,
            voluntary_switches: usage.voluntary_switches,
            involuntary_switches: usage.involuntary_switches,
            cpu_per_tick_us: usage.cpu_ns as f64 / 1e3 / status.ticks_run.max(1) as f64,
        }),
        scheduling: if status.grants.policy == 1 {
            format!("fifo {}", status.grants.priority)
        } else {
            "other".into()
        },
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
                    asked: (grant.value > 0 || *step == messages::realtime::RealtimeStep::Affinity)
                        .then_some(grant.value),
                    granted: grant.granted(),
                    refused: (!grant.granted()).then(|| errno_text(grant.errno)),
                }
            })
            .collect(),
    }
}

/// What became of the messages on their way to the flight log, which keeps `kept`.
pub fn log_section(kept: &str, fate: &Fate) -> schema::LogSection {
    let by_topic = |counts: &Counts| {
        TOPICS
            .iter()
            .map(|topic| (*topic).to_owned())
            .zip(*counts)
            .collect()
    };
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
