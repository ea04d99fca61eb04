//! Early wake-up of the plant: how long before each tick its timer expires, and the processor time spent waiting.

use crate::series::histogram;
use errors::Failure;
use hdrhistogram::Histogram;
use messages::realtime::Lead;
use serde::{Deserialize, Serialize};

/// The lead of the plant's timer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LeadSection {
    /// How far ahead of its tick the timer was set at take-off [us]; 0 is at the tick.
    pub lead_us: f64,
    /// The shortest lead of a tick that was flown [us].
    pub least_us: f64,
    /// Their median [us].
    pub median_us: f64,
    /// The longest one [us].
    pub most_us: f64,
    /// 90th percentile of what a rehearsal took before take-off [us]; 0 where none is held.
    pub rehearsal_us: f64,
    /// 90th percentile of the timer's lateness, measured before take-off [us]; 0 where it was not.
    pub timer_p90_us: f64,
    /// Ticks after the first that the mixer, the last of the chain, rehearsed.
    pub rehearsals: u64,
    /// From the timer's waking to the beginning of the tick, rehearsals among it: share of the loops' processor [%].
    pub processor_percent: f64,
}

/// Counts the leads of the ticks that were flown.
#[derive(Debug)]
pub(super) struct LeadStatistics {
    leads: Histogram<u64>,
    /// A histogram knows its ends only in steps [ns].
    least_ns: u64,
    most_ns: u64,
    /// What the plant had left of them when it woke, over all ticks [ns].
    left_ns: u64,
}

impl LeadStatistics {
    pub(super) fn new() -> Result<Self, Failure> {
        Ok(Self {
            leads: histogram()?,
            least_ns: u64::MAX,
            most_ns: 0,
            left_ns: 0,
        })
    }

    /// Takes the lead of a tick, and how late the timer was that was set to it [ns]: the rest was waited out.
    pub(super) fn take(&mut self, lead_ns: u64, late_ns: u64) {
        self.leads.saturating_record(lead_ns);
        (self.least_ns, self.most_ns) = (self.least_ns.min(lead_ns), self.most_ns.max(lead_ns));
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
        let least_ns = self.least_ns.min(self.most_ns);
        LeadSection {
            lead_us: us(at_take_off.lead_ns),
            least_us: us(least_ns),
            median_us: us(self
                .leads
                .value_at_quantile(0.5)
                .clamp(least_ns, self.most_ns)),
            most_us: us(self.most_ns),
            rehearsal_us: us(at_take_off.rehearsal_ns),
            timer_p90_us: us(at_take_off.timer_p90_ns),
            rehearsals,
            processor_percent: 100.0 * self.left_ns as f64 / flown_ns.max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lead_that_followed_the_flight_says_between_what_and_one_that_is_set_does_not() {
        let set = LeadSection {
            lead_us: 124.0,
            least_us: 124.0,
            median_us: 124.0,
            most_us: 124.0,
            rehearsal_us: 33.0,
            timer_p90_us: 27.2,
            rehearsals: 990,
            processor_percent: 9.87,
        };
        assert_eq!(
            set.text(1000),
            "Lead 124 us before the tick (before take-off: timer p90 27 us, rehearsal p90 33 us); rehearsed 990 of \
             1000 ticks; waiting took 9.9 % of the loops' processor"
        );
        let follows = LeadSection {
            least_us: 96.4,
            median_us: 131.0,
            most_us: 210.0,
            ..set
        };
        assert_eq!(
            follows.text(1000),
            "Lead 124 us before the tick at take-off, 96 to 210 us in flight, 131 us in the median (before take-off: \
             timer p90 27 us, rehearsal p90 33 us); rehearsed 990 of 1000 ticks; waiting took 9.9 % of the loops' processor"
        );
        let only_waits = LeadSection {
            rehearsal_us: 0.0,
            rehearsals: 0,
            ..follows
        };
        assert!(
            only_waits
                .text(1000)
                .contains("timer p90 27 us); no rehearsals; waiting took"),
            "{}",
            only_waits.text(1000)
        );
        assert!(
            LeadSection::default()
                .text(1000)
                .starts_with("Lead none: the plant's timer is set to the beginning")
        );
    }
}

#[cfg(test)]
mod tally_lead_tests {
    use super::*;

    #[test]
    fn a_lead_that_is_set_is_no_longer_and_no_shorter_in_flight() {
        let mut tally = LeadStatistics::new().unwrap();
        (0..9).for_each(|_| tally.take(123_457, 0));
        let lead = tally.section(
            &Lead {
                lead_ns: 123_457,
                ..Lead::default()
            },
            0,
            1,
        );
        assert_eq!(
            [lead.lead_us, lead.least_us, lead.median_us, lead.most_us],
            [123.457; 4]
        );
    }

    #[test]
    fn before_the_first_tick_there_was_none() {
        let lead = LeadStatistics::new()
            .unwrap()
            .section(&Lead::default(), 0, 0);
        assert_eq!(lead, LeadSection::default());
    }
}
