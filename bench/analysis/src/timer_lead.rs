//! Early wake-up of the plant: how long before each tick its timer expires, and the processor time spent waiting.

use crate::series::Latencies;
use errors::Failure;
use messages::realtime::Lead;
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LeadSection {
    /// How far ahead of its tick the timer was set at take-off [us]; 0 is at the tick.
    pub lead_us: f64,
    /// The shortest lead of a tick that was flown [us].
    pub least_us: f64,
    pub median_us: f64,
    pub most_us: f64,
    /// 90th percentile of what a warm-up run took before take-off [us]; 0 where none is held.
    pub rehearsal_us: f64,
    /// 90th percentile of the timer's lateness, measured before take-off [us]; 0 where it was not.
    pub timer_p90_us: f64,
    /// Ticks after the first with a warm-up run of the mixer, the last of the chain.
    pub rehearsals: u64,
    /// From the timer's waking to the beginning of the tick, warm-up runs among it: share of the loops' processor [%].
    pub processor_percent: f64,
}

#[derive(Debug)]
pub(super) struct LeadStatistics {
    leads: Latencies,
    /// What the plant had left of them when it woke, over all ticks [ns].
    left_ns: u64,
}

impl LeadStatistics {
    pub(super) fn new() -> Result<Self, Failure> {
        Ok(Self {
            leads: Latencies::new()?,
            left_ns: 0,
        })
    }

    /// Takes the lead of a tick, and how late the timer was that was set to it [ns]: the rest was waited out.
    pub(super) fn take(&mut self, lead_ns: u64, late_ns: u64) {
        self.leads.record(lead_ns);
        self.left_ns += lead_ns.saturating_sub(late_ns);
    }

    /// What the report says of a flight whose ticks took `flown_ns`.
    pub(super) fn section(
        &self,
        at_take_off: &Lead,
        rehearsals: u64,
        flown_ns: u64,
    ) -> LeadSection {
        let us = |ns: u64| ns as f64 / 1e3;
        LeadSection {
            lead_us: us(at_take_off.lead_ns),
            least_us: us(self.leads.min_ns()),
            median_us: us(self.leads.quantile_ns(0.5)),
            most_us: us(self.leads.max_ns()),
            rehearsal_us: us(at_take_off.rehearsal_ns),
            timer_p90_us: us(at_take_off.timer_p90_ns),
            rehearsals,
            processor_percent: 100.0 * self.left_ns as f64 / flown_ns.max(1) as f64,
        }
    }
}
