//! The lead of the plant's timer in flight: how long it was, and what waiting for the ticks cost.

use hdrhistogram::Histogram;
use model::realtime::Lead;

use crate::lead::LeadSection;
use crate::tally::series::histogram;
use failure::Failure;

/// Counts the leads of the ticks that were flown.
#[derive(Debug)]
pub(super) struct LeadTally {
    leads: Histogram<u64>,
    /// A histogram knows its ends only in steps [ns].
    least_ns: u64,
    most_ns: u64,
    /// What the plant had left of them when it woke, over all ticks [ns].
    left_ns: u64,
}

impl LeadTally {
    /// Of no tick.
    ///
    /// # Errors
    /// Those of [`histogram`].
    pub(super) fn new() -> Result<Self, Failure> {
        Ok(Self { leads: histogram()?, least_ns: u64::MAX, most_ns: 0, left_ns: 0 })
    }

    /// Takes the lead of a tick, and how late the timer was that was set to it [ns]: the rest was waited out.
    pub(super) fn take(&mut self, lead_ns: u64, late_ns: u64) {
        self.leads.saturating_record(lead_ns);
        (self.least_ns, self.most_ns) = (self.least_ns.min(lead_ns), self.most_ns.max(lead_ns));
        self.left_ns += lead_ns.saturating_sub(late_ns);
    }

    /// What the report says of a flight whose ticks took `flown_ns`.
    pub(super) fn section(&self, at_take_off: &Lead, rehearsals: u64, flown_ns: u64) -> LeadSection {
        let us = |ns: u64| ns as f64 / 1e3;
        let least_ns = self.least_ns.min(self.most_ns);
        LeadSection {
            lead_us: us(at_take_off.lead_ns),
            least_us: us(least_ns),
            median_us: us(self.leads.value_at_quantile(0.5).clamp(least_ns, self.most_ns)),
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
    fn a_lead_that_is_set_is_no_longer_and_no_shorter_in_flight() {
        let mut tally = LeadTally::new().unwrap();
        (0..9).for_each(|_| tally.take(123_457, 0));
        let lead = tally.section(&Lead { lead_ns: 123_457, ..Lead::default() }, 0, 1);
        assert_eq!([lead.lead_us, lead.least_us, lead.median_us, lead.most_us], [123.457; 4]);
    }

    #[test]
    fn before_the_first_tick_there_was_none() {
        let lead = LeadTally::new().unwrap().section(&Lead::default(), 0, 0);
        assert_eq!(lead, LeadSection::default());
    }
}
