//! The section of the report on outages.

use crate::faults::{InjectedFault, ProcessFailure};
use crate::miss_causes::MissCause;
use crate::processor_trace::RunnerTime;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Outages in the text and on the page; report.json has more.
pub const WORST_SHOWN: usize = 10;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OutageSection {
    /// How many outages each class has, by the stage that they were due to; the one with the most misses first.
    pub classes: Vec<CauseCount>,
    /// Deadlines missed in an outage that lasts, or is not classified yet.
    pub pending: u64,
    /// The longest row of ticks without an output in time, of each stage that had one, and of all stages at once
    /// ([`MACHINE`](crate::schema::MACHINE)).
    pub longest: BTreeMap<String, u64>,
    /// Outages with missed deadlines that count in no such row: messages were lost there, so who was out is not known.
    pub unmeasured: u64,
    /// The longest outages first, by [`OutageCase::weight`].
    pub worst: Vec<OutageCase>,
}

impl OutageSection {
    /// Outages of all classes, and the deadlines missed in them. A file may hold any numbers.
    pub fn totals(&self) -> (u64, u64) {
        let sum = |of: fn(&CauseCount) -> u64| {
            let counts = self.classes.iter().map(of);
            counts.fold(0, u64::saturating_add)
        };
        (sum(|it| it.outages), sum(|it| it.missed))
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CauseCount {
    pub class: MissCause,
    /// The stage that was late; none where the host or a quota stopped all, or where no stage is known.
    pub stage: Option<String>,
    pub outages: u64,
    pub missed: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutageCase {
    pub tick: u64,
    /// Begin of that tick as time of the flight [s].
    pub time_s: f64,
    pub ticks: u64,
    pub missed: u64,
    /// From the instant when the delayed stage was due to its next sign of life [us]; 0 where no stage is known.
    pub delay_us: f64,
    /// That instant, from the beginning of the first tick on [us].
    pub due_us: f64,
    pub class: MissCause,
    pub stage: Option<String>,
    pub evidence: String,
    /// Who had the loops' processor in the delay, the longest first; empty without a trace.
    pub ran: Vec<RunnerTime>,
    /// Faults of messages, stages and the processor that acted in it, or just before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<String>,
    /// What the stages did around its first tick and its last one; ticks between these are left out.
    pub timeline: Vec<TimelineTick>,
}

impl OutageCase {
    /// The order of outages: by their ticks, then by the deadlines missed, then by the delay [us].
    pub const fn weight(&self) -> (u64, u64, u64) {
        (self.ticks, self.missed, self.delay_us as u64)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimelineTick {
    pub tick: u64,
    /// Whether its command missed the deadline, by the plant's verdict.
    pub missed: bool,
    /// Plant, outer, inner, mixer; those that published something.
    pub stages: Vec<TimelineStage>,
}

/// What a stage did in a tick; times from the beginning of the outage's first tick on [us].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimelineStage {
    pub role: String,
    pub wake_us: f64,
    pub send_us: f64,
    /// Its driving input was of the tick; otherwise it had waited until its cut-off.
    pub is_fresh: bool,
}

impl OutageSection {
    /// Adds to each outage the faults that were on.
    pub fn with_faults(
        mut self,
        faults: &[InjectedFault],
        period_s: f64,
        failures: &[ProcessFailure],
    ) -> Self {
        for case in &mut self.worst {
            let last = case.tick + case.ticks - 1;
            let on = faults
                .iter()
                .filter(|fault| fault.is_active(case.tick, last, period_s, failures));
            case.faults = on.map(|fault| fault.what.clone()).collect();
        }
        self
    }
}
