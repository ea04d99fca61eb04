//! The lead of the plant's timer in the report: how far ahead of the ticks it is set, and at what price.

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

impl LeadSection {
    /// As a line of text; of a flight of `ticks`.
    #[must_use]
    pub fn text(&self, ticks: u64) -> String {
        let Self { lead_us, least_us, median_us, most_us, rehearsal_us, timer_p90_us, rehearsals, .. } = self;
        if *lead_us == 0.0 {
            return "Lead none: the plant's timer is set to the beginning of the tick".into();
        }
        let in_flight = if least_us < most_us {
            format!(" at take-off, {least_us:.0} to {most_us:.0} us in flight, {median_us:.0} us in the median")
        } else {
            String::new()
        };
        let (rehearsal, rehearsed) = if *rehearsal_us > 0.0 {
            (format!(", rehearsal p90 {rehearsal_us:.0} us"), format!("rehearsed {rehearsals} of {ticks} ticks"))
        } else {
            (String::new(), "no rehearsals".into())
        };
        format!(
            "Lead {lead_us:.0} us before the tick{in_flight} (before take-off: timer p90 {timer_p90_us:.0} \
             us{rehearsal}); {rehearsed}; it took {:.1} % of the loops' processor",
            self.processor_percent
        )
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
             1000 ticks; it took 9.9 % of the loops' processor"
        );
        let follows = LeadSection { least_us: 96.4, median_us: 131.0, most_us: 210.0, ..set };
        assert_eq!(
            follows.text(1000),
            "Lead 124 us before the tick at take-off, 96 to 210 us in flight, 131 us in the median (before take-off: \
             timer p90 27 us, rehearsal p90 33 us); rehearsed 990 of 1000 ticks; it took 9.9 % of the loops' processor"
        );
        let only_waits = LeadSection { rehearsal_us: 0.0, rehearsals: 0, ..follows };
        assert!(
            only_waits.text(1000).contains("timer p90 27 us); no rehearsals; it took"),
            "{}",
            only_waits.text(1000)
        );
        assert!(LeadSection::default().text(1000).starts_with("Lead none: the plant's timer is set to the beginning"));
    }
}
