//! Sections of the report that follow from one status board or one log.

use crate::schema;
use errors::errno_text;
use flight_log::TOPICS;
use flight_log::entry::Counts;
use flight_log::writer::Fate;
use messages::blackboards::{RolePhase, Status};
use messages::channels::{OUTAGES_KEPT, OutageReason, Redundancy, Switchover, SwitchoverReason};
use messages::inspection::{Reason, Rejections};
use messages::realtime::RealtimeStep;
use messages::role::{Channel, MOST_CHANNELS};
use std::collections::BTreeMap;

pub fn rejections(rejections: &Rejections) -> BTreeMap<String, u64> {
    let counted = Reason::ALL
        .iter()
        .map(|reason| (reason.name(), rejections.of(*reason)));
    counted
        .map(|(reason, count)| (reason.to_owned(), count))
        .collect()
}

/// The plant's account of the channels, in flight time.
pub fn redundancy(account: &Redundancy, period_s: f64) -> schema::RedundancySection {
    let channel = |place: u64| {
        let name = Channel::from_wire(place).map_or("", Channel::name);
        name.to_owned()
    };
    let counted = account.channels.min(MOST_CHANNELS as u64);
    let by_channel = |counts: &[u64]| {
        (0..counted)
            .map(channel)
            .zip(counts.iter().copied())
            .collect()
    };
    let kept = account.outage_count.min(OUTAGES_KEPT as u64);
    let outages = account.outages[..kept as usize].iter();
    let time_s = |tick: u64| tick as f64 * period_s;
    let switchover = |it: &Switchover| schema::Switchover {
        time_s: time_s(it.tick),
        tick: it.tick,
        from: channel(it.from),
        to: channel(it.to),
        reason: SwitchoverReason::from_wire(it.reason)
            .map_or("", SwitchoverReason::name)
            .into(),
        command_step_rad_s: it.command_step_rad_s,
    };
    let difference = |place: usize| {
        let ticks = account.compared[place];
        let mean_square = account.difference_square_sum_rad2_s2[place] / ticks as f64;
        let difference = schema::CommandDifference {
            ticks,
            rms_rad_s: mean_square.sqrt(),
            max_rad_s: account.difference_max_rad_s[place],
        };
        (ticks > 0).then(|| (channel(place as u64), difference))
    };
    schema::RedundancySection {
        laws: BTreeMap::new(),
        channels: account.channels,
        active: channel(account.active),
        ticks_flown: by_channel(&account.flown),
        ticks_unprotected: account.unprotected,
        longest_unprotected_ms: time_s(account.longest_unprotected) * 1e3,
        ticks_masked: account.masked,
        ticks_not_fresh: account.not_fresh,
        ticks_compared: account.votes,
        mismatches: account.mismatches,
        first_mismatch_s: (account.mismatches > 0).then(|| time_s(account.first_mismatch)),
        ticks_outvoted: by_channel(&account.outvoted),
        handovers: account.handovers,
        outages: outages
            .map(|outage| schema::ChannelOutage {
                channel: channel(outage.channel),
                time_s: time_s(outage.tick),
                tick: outage.tick,
                ticks: outage.ticks,
                reason: OutageReason::from_wire(outage.reason)
                    .map_or("", OutageReason::name)
                    .into(),
                handover: outage.is_handover == 1,
            })
            .collect(),
        outages_left_out: account.outage_count - kept,
        switchovers: account.switchovers().iter().map(switchover).collect(),
        differences: (0..MOST_CHANNELS).filter_map(difference).collect(),
    }
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
        is_successor: false,
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
