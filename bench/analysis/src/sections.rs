//! Sections of the report that follow from one status board or one log.

use crate::schema;
use errors::errno_text;
use flight_log::TOPICS;
use flight_log::entry::Counts;
use flight_log::writer::Fate;
use messages::blackboards::{RolePhase, Status};
use messages::inspection::{Reason, Rejections};
use messages::realtime::RealtimeStep;
use std::collections::BTreeMap;

pub fn rejections(rejections: &Rejections) -> BTreeMap<String, u64> {
    let counted = Reason::ALL
        .iter()
        .map(|reason| (reason.name(), rejections.of(*reason)));
    counted
        .map(|(reason, count)| (reason.to_owned(), count))
        .collect()
}

pub fn role_section(status: &Status) -> schema::RoleSection {
    let landed = status.phase() == RolePhase::Landed;
    let (usage, grants) = (&status.usage, &status.grants);
    let step = |step: &RealtimeStep| {
        let grant = grants.of(*step);
        let name = serde_json::to_value(step).unwrap_or_default();
        let has_number = grant.value > 0 || *step == RealtimeStep::Affinity;
        schema::RtStep {
            step: name.as_str().unwrap_or_default().into(),
            asked: has_number.then_some(grant.value),
            granted: grant.granted(),
            refused: (!grant.granted()).then(|| errno_text(grant.errno)),
        }
    };
    let steps = RealtimeStep::ALL
        .iter()
        .filter(|step| grants.of(**step).asked == 1);
    schema::RoleSection {
        ticks_run: status.ticks_run,
        ticks_skipped: status.ticks_skipped,
        ticks_stale: status.ticks_stale,
        rejected: rejections(&status.rejections),
        landed,
        usage: landed.then(|| schema::LoopUsage {
            allocations: usage.counted_allocations(),
            minor_faults: usage.minor_faults,
            major_faults: usage.major_faults,
            voluntary_switches: usage.voluntary_switches,
            involuntary_switches: usage.involuntary_switches,
            cpu_per_tick_us: usage.cpu_ns as f64 / 1e3 / status.ticks_run.max(1) as f64,
        }),
        scheduling: match grants.policy {
            1 => format!("fifo {}", grants.priority),
            _ => "other".into(),
        },
        realtime: steps.map(step).collect(),
    }
}

/// What became of the messages on their way to the flight log, which keeps `kept`.
pub fn log_section(kept: &str, fate: &Fate) -> schema::LogSection {
    let topics = || TOPICS.iter().map(|topic| (*topic).to_owned());
    let by_topic = |counts: &Counts| topics().zip(*counts).collect();
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
