//! The report of a good flight, which tests modify.

use crate::schema::{NotFresh, Report, SCHEMA};
use crate::series::Statistics;
use hdrhistogram::Histogram;
use serde_json::json;

/// 20 s on the clock without a miss.
pub(crate) fn good() -> Report {
    let stage = json!({
        "ticks_run": 20_000, "ticks_skipped": 0, "ticks_stale": 0, "rejected": {}, "landed": true, "usage": null,
        "scheduling": "other", "realtime": [],
    });
    let mut loops = Histogram::new(3).unwrap();
    loops.record_n(50_000, 20_000).unwrap();
    let series = ["loop", "wake.plant"].map(|name| Statistics::of(name, &loops));
    let report = json!({
        "schema": SCHEMA,
        "run": {
            "run_id": 1, "started": "", "instance": "default", "version": "0.1.0", "trajectory": "hover",
            "preset": "flight", "period_us": 1000.0, "wall_period_us": 1000.0, "settings_fingerprint": "",
            "ending": "completed", "in_flight": false,
        },
        "verdict": { "status": "FLYING", "exit_code": 0, "gates": [] },
        "ticks": {
            "run": 20_000, "skipped": 0, "elapsed_s": 20.0, "elapsed_periods": 20_000, "identity_holds": true,
        },
        "deadlines": {
            "not_fresh": NotFresh::default(), "missed": 0, "missed_ppm": 0.0, "missed_by_stamps": 0, "late": [],
            "runs": [],
        },
        "flight": { "states": 20_000, "recent_error_max_m": 0.01, "recent_s": 5.0 },
        "theorem": {
            "holds": true, "is_live": true, "ticks": 20_000, "ticks_checked": 20_000, "ticks_judged": 20_000,
            "steps_adapted": 19_999,
        },
        "swaps": [],
        "series": series,
        "roles": { "outer": stage, "inner": stage, "mixer": stage },
        "recorder": {},
        "host": {
            "kernel": "", "preemption": "", "cpu": "", "cpus": 1, "hypervisor": null, "clock_source": "",
            "rt_runtime_us": 0,
        },
        "steal": { "stolen_ms": 0, "percent": 0.0, "of_ms": 20_000, "processor": 1 },
    });
    serde_json::from_value(report).unwrap()
}

/// Makes so many ticks fly without a fresh command on time.
pub(crate) fn not_fresh(report: &mut Report, missed: u64, stale: u64, skipped: u64) {
    report.ticks.skipped = skipped;
    report.deadlines.not_fresh = Some(NotFresh::new(missed, stale, &report.ticks));
}
