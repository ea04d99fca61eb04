//! What is counted and measured of three recorded flights is as in `snapshots/`: `INSTA_UPDATE=always cargo test -p
//! analysis` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../../shared/reference/hashed.rs"]
mod hashed;

use std::path::Path;

use analysis::distribution::buckets;
use analysis::flight_statistics::FlightStatistics;
use analysis::miss_analysis::MissAnalysis;
use analysis::series::Series;
use analysis::states::{Joiner, is_final_command};
use analysis::tracking::Tracking;
use controller::Trajectory;
use flight_log::entry::LogEntry;
use flight_log::reader::LogReader;
use hashed::hashed;
use messages::blackboards::Run;
use messages::grid::Pace;
use serde_json::json;

/// The figures that a person checks.
const SHOWN: [(&str, &str); 7] = [
    (
        "",
        "joined_messages missed not_fresh outages lost late runs stretches",
    ),
    ("/ticks", "run skipped elapsed_s identity_holds"),
    (
        "/flight",
        "states position_error_rms_m position_error_max_m lowest_z_m saturated_ticks",
    ),
    (
        "/flight",
        "effort tilt_error/rms_rad tilt_error/max_rad yaw_error/max_rad",
    ),
    ("/swaps", "tick changes"),
    ("/series", "name count p50_us p99_us max_us"),
    (
        "/theorem",
        "holds ticks ticks_judged v_th_end rate_error_max_rad_s torque violations",
    ),
];

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
        statistics.begin_autopsy(true, [0; 3]);
        let (mut joiner, mut joined_messages) = (Joiner::default(), 0);
        for entry in &entries {
            statistics.take(entry);
            let is_joined = match entry {
                LogEntry::RotorSpeeds(message) => !is_final_command(message),
                other => other.topic() < 4,
            };
            if is_joined {
                joined_messages += 1;
                joiner.take(entry);
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
            "theorem": statistics.stages.theorem.section(),
            "swaps": statistics.swaps,
            "series": statistics.series.statistics(),
            "traces": statistics.tracer.traces(),
        });
        let text = serde_json::to_string_pretty(&figures).unwrap();
        let shown = hashed::figures(&figures, &SHOWN);
        insta::assert_snapshot!(flight, hashed(flight, &text, &shown));
    }
}
