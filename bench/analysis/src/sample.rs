//! The report of a good flight, which tests modify.

use crate::host::Steal;
use crate::schema::{
    ControlPerformance, DeadlineSection, NotFresh, RoleSection, RunSection, Ticks,
};
use crate::series::Statistics;
use crate::theorem::Theorem;
use crate::verdicts::Evidence;
use hdrhistogram::Histogram;
use messages::blackboards::EndReason;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeMap;

pub(crate) struct Sample {
    pub(crate) run: RunSection,
    pub(crate) ending: Option<EndReason>,
    pub(crate) ticks: Ticks,
    pub(crate) deadlines: DeadlineSection,
    pub(crate) performance: ControlPerformance,
    pub(crate) theorem: Theorem,
    pub(crate) series: Vec<Statistics>,
    pub(crate) roles: BTreeMap<String, RoleSection>,
    pub(crate) steal: Steal,
    pub(crate) lost: u64,
}

fn from_json<T: DeserializeOwned>(value: &Value) -> T {
    T::deserialize(value).unwrap()
}

impl Sample {
    /// 20 s on the clock without a miss.
    pub(crate) fn good() -> Self {
        let run = json!({
            "run_id": 1, "started": "", "instance": "default", "version": "0.1.0", "trajectory": "hover",
            "preset": "flight", "period_us": 1000.0, "wall_period_us": 1000.0, "settings_fingerprint": "",
            "ending": "completed", "in_flight": false,
        });
        let stage = json!({
            "ticks_run": 20_000, "ticks_skipped": 0, "ticks_stale": 0, "rejected": {}, "landed": true, "usage": null,
            "scheduling": "other", "realtime": [],
        });
        let ticks = json!({
            "run": 20_000, "skipped": 0, "elapsed_s": 20.0, "elapsed_periods": 20_000, "identity_holds": true,
        });
        let not_fresh = NotFresh::default();
        let deadlines = json!({
            "not_fresh": not_fresh, "missed": 0, "missed_ppm": 0.0, "missed_by_stamps": 0, "late": [], "runs": [],
        });
        let stage = |role: &str| (role.to_owned(), from_json(&stage));
        let mut loops = Histogram::new(3).unwrap();
        loops.record_n(50_000, 20_000).unwrap();
        Self {
            run: from_json(&run),
            ending: Some(EndReason::Completed),
            ticks: from_json(&ticks),
            deadlines: from_json(&deadlines),
            performance: ControlPerformance {
                states: 20_000,
                recent_error_max_m: 0.01,
                recent_s: 5.0,
                ..ControlPerformance::default()
            },
            theorem: Theorem {
                holds: true,
                is_live: true,
                ticks_checked: 20_000,
                steps_adapted: 19_999,
                ..Theorem::default()
            },
            series: ["loop", "wake.plant"]
                .map(|name| Statistics::of(name, &loops))
                .into(),
            roles: ["outer", "inner", "mixer"].map(stage).into(),
            steal: from_json(
                &json!({ "stolen_ms": 0, "percent": 0.0, "of_ms": 20_000, "processor": 1 }),
            ),
            lost: 0,
        }
    }

    /// So many of its ticks flew without a fresh command on time.
    pub(crate) fn not_fresh(&mut self, missed: u64, stale: u64, skipped: u64) {
        self.ticks.skipped = skipped;
        self.deadlines.not_fresh = Some(NotFresh::new(missed, stale, &self.ticks));
    }

    pub(crate) fn evidence(&self) -> Evidence<'_> {
        Evidence {
            run: &self.run,
            ending: self.ending,
            ticks: &self.ticks,
            deadlines: &self.deadlines,
            performance: &self.performance,
            theorem: &self.theorem,
            series: &self.series,
            roles: &self.roles,
            steal: &self.steal,
            lost: self.lost,
        }
    }
}
