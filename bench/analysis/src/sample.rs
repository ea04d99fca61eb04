//! The report of a good flight, which tests modify.

use crate::finding::Diagnosis;
use crate::host::{ContainerSection, InterruptSection};
use crate::outages::OutageSection;
use crate::schema::{AngleErrors, NotFresh, Report, SCHEMA, Verdicts};
use crate::series::{Latencies, Statistics};
use flight_log::build::Build;
use serde_json::json;

/// 20 s on the clock without a miss.
pub(crate) fn good() -> Report {
    let stage = json!({
        "ticks_run": 20_000, "ticks_skipped": 0, "ticks_stale": 0, "rejected": {}, "landed": true, "usage": null,
        "scheduling": "other", "realtime": [],
    });
    let mut loops = Latencies::new().unwrap();
    (0..20_000).for_each(|_| loops.record(50_000));
    let series = ["loop", "wake.plant"].map(|name| Statistics::of(name, &loops));
    let report = json!({
        "schema": SCHEMA,
        "run": {
            "run_id": 1, "started": "", "instance": "default", "version": "0.1.0", "trajectory": "hover",
            "preset": "flight", "period_us": 1000.0, "wall_period_us": 1000.0, "settings_fingerprint": "",
            "ending": "completed", "in_flight": false, "hostname": "", "build": Build::default(), "airframe": "",
            "airframe_sha256": "", "laws": {}, "last_words": [],
        },
        "words": Verdicts::default(),
        "autopsy": OutageSection::default(),
        "deaths": [], "deaths_left_out": 0,
        "verdict": { "status": "FLYING", "exit_code": 0, "gates": [] },
        "ticks": {
            "run": 20_000, "skipped": 0, "elapsed_s": 20.0, "elapsed_periods": 20_000, "identity_holds": true,
        },
        "deadlines": {
            "not_fresh": NotFresh::default(), "missed": 0, "missed_ppm": 0.0, "missed_by_stamps": 0, "late": [],
            "runs": [], "stretches": [], "stretches_left_out": 0,
        },
        "flight": {
            "states": 20_000, "recent_error_max_m": 0.01, "recent_s": 5.0, "yaw_error": AngleErrors::default(),
            "effort": {
                "commands": 20_000, "saturated_percent": 1.0, "agitation_rad_s": 10.0, "command_mean_rad_s": 200.0,
            },
        },
        "theorem": {
            "holds": true, "is_live": true, "ticks": 20_000, "ticks_checked": 20_000, "ticks_judged": 20_000,
            "steps_adapted": 19_999, "torque": { "wrenches": 20_000, "rotors": 19_998 },
        },
        "swaps": [], "swaps_left_out": 0,
        "lead": {}, "doctor": Diagnosis::default(), "container": ContainerSection::default(),
        "interrupts": InterruptSection::default(), "distributions": [],
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
