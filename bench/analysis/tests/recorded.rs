//! What is counted and measured of three recorded flights is as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! analysis` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::path::Path;

use analysis::distribution::buckets;
use analysis::flight_statistics::FlightStatistics;
use analysis::miss_analysis::MissAnalysis;
use analysis::series::Series;
use analysis::states::{Joiner, LoopMessage};
use analysis::tracking::Tracking;
use controller::Trajectory;
use flight_log::entry::LogEntry;
use flight_log::reader::LogReader;
use messages::blackboards::Run;
use messages::grid::Pace;
use serde_json::json;

/// All three flew this trajectory at 1 kHz.
const TRACKING: Tracking = Tracking::of(Trajectory::Lissajous, 1e-3);

fn entries(reader: &mut LogReader) -> Vec<LogEntry> {
    std::iter::from_fn(|| reader.next_entry().unwrap().copied()).collect()
}

#[test]
fn figures_of_recorded_flights_are_their_snapshots() {
    for flight in ["real-time", "swap", "message-faults"] {
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/tests/golden");
        let mut reader = LogReader::open(&golden.join(flight).join("flight.mcap")).unwrap();
        let entries = entries(&mut reader);
        let (pace, t0_ns) = (reader.pace().unwrap(), reader.number("t0_ns").unwrap());
        let mut statistics = FlightStatistics::new(pace, t0_ns, TRACKING).unwrap();
        statistics.begin_autopsy(true);
        let (mut joiner, mut joined_messages) = (Joiner::default(), 0);
        for entry in &entries {
            let tick = entry.envelope().tick;
            statistics.take(entry);
            let part = match entry {
                LogEntry::Wrench(message) => Some(LoopMessage::Wrench(message.content, None)),
                other => LoopMessage::of(other),
            };
            if let Some(part) = part {
                joined_messages += 1;
                joiner.take(tick, part);
            }
        }
        while let Some(joined) = joiner.next_complete().or_else(|| joiner.rest()) {
            statistics.tracer.take(&joined);
        }
        let period_ns = match pace {
            Pace::Realtime(grid) => grid.period_ns,
            Pace::Lockstep => 0,
        };
        let run = Run {
            t0_ns,
            period_ns,
            last_tick: statistics.newest_tick(),
            ..Run::default()
        };
        statistics.finish(&run, t0_ns + 1_000_000_000);
        let ticks = statistics.ticks(&run);
        let late = statistics.series.flight(Series::Late);
        // Every fiftieth point is enough: a plot has one for each tick.
        let mut traces = serde_json::to_value(statistics.tracer.traces()).unwrap();
        thin(&mut traces);
        let figures = json!({
            "joined_messages": joined_messages,
            "ticks": ticks,
            "not_fresh": statistics.not_fresh(&ticks),
            "missed": statistics.miss_runs.missed,
            "runs": statistics.miss_runs.lengths(),
            "late": late.map(buckets),
            "stretches": statistics.late_commands.stretches,
            "outages": statistics.autopsy.as_ref().map(MissAnalysis::section),
            "lost": statistics.lost(),
            "flight": statistics.flight(),
            "theorem": statistics.theorem.section(),
            "swaps": statistics.swaps,
            "series": statistics.series.statistics(),
            "traces": traces,
        });
        insta::assert_snapshot!(flight, serde_json::to_string_pretty(&figures).unwrap());
    }
}

fn thin(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Object(fields) => fields.values_mut().for_each(thin),
        serde_json::Value::Array(points) => *points = points.iter().step_by(50).cloned().collect(),
        _ => {}
    }
}
