//! The lead: how far ahead of its tick the plant's timer is set.
//!
//! A timer of the kernel is late by some microseconds, and now and then by many. Set ahead by more than that, it wakes
//! the plant before the tick in all but a few cases. The plant rehearses in the time that is left, and reads the clock until
//! the tick begins. This file chooses the lead. It measures this machine for that, on the processor of the loops, with
//! all loops there: between their arming and t_0, in ticks of the flight's length that are only rehearsed.

use model::grid::Grid;
use model::realtime::{LONGEST_LEAD_NS, Lead, LeadSetting, RealtimeSettings};
use wire::clock::{now_ns, sleep_until};
use wire::error::Error;

/// The other roles are in their loops so long after the plant has said that it will fly [ns].
const IN_LOOPS_NS: u64 = 6_000_000;
/// Longest time between two measurements [ns]: of a slower flight there would be too few.
const EVERY_NS: u64 = 10_000_000;
/// An automatic lead covers so many times the lateness that one timer in ten exceeds.
///
/// Of the hundred and some that are measured, this quantile is one that a host which stalls now and then does not bend.
const TIMERS: u64 = 3;
/// And so many times what one rehearsal in ten exceeds, because few of those in flight shall find too little time left.
const REHEARSALS: u64 = 2;
/// Added to what was measured, so that the plant reads the clock at least so long [ns].
const MARGIN_NS: u64 = 10_000;
/// Share of the period that an automatic lead takes at most [%].
const MOST_PERCENT: u64 = 25;

/// Chooses the lead of a flight that begins at `grid.t0_ns`, and returns before then.
///
/// `rehearse` has all stages rehearse, and returns when they have.
///
/// # Errors
/// Those of `rehearse`.
pub fn choose(
    settings: &RealtimeSettings,
    is_fifo: bool,
    grid: &Grid,
    mut rehearse: impl FnMut() -> Result<(), Error>,
) -> Result<Lead, Error> {
    if settings.lead == LeadSetting::Fixed(0) || (settings.lead == LeadSetting::Auto && !is_fifo) {
        return Ok(Lead::default());
    }
    let every_ns = grid.period_ns.min(EVERY_NS);
    let longest_ns = match settings.lead {
        LeadSetting::Fixed(ns) => ns,
        LeadSetting::Auto => most(grid.period_ns),
    };
    let (mut timers, mut rehearsals) = (Vec::new(), Vec::new());
    let mut next_ns = now_ns() + IN_LOOPS_NS;
    // The timer of tick 0 is still to be set then.
    while next_ns + 2 * every_ns + longest_ns < grid.t0_ns {
        if sleep_until(next_ns) {
            let woke_ns = now_ns();
            timers.push(woke_ns - next_ns);
            if settings.rehearse {
                rehearse()?;
                rehearsals.push(now_ns() - woke_ns);
            }
        }
        // One that is over would measure nothing.
        next_ns += every_ns * (now_ns().saturating_sub(next_ns) / every_ns + 1);
    }
    let (timer_p90_ns, rehearsal_ns) = (quantile(&mut timers, 90), quantile(&mut rehearsals, 90));
    Ok(match settings.lead {
        LeadSetting::Fixed(lead_ns) => Lead { lead_ns, rehearsal_ns, timer_p90_ns },
        LeadSetting::Auto => automatic(timer_p90_ns, rehearsal_ns, grid.period_ns),
    })
}

/// Long enough for a rehearsal as nine in ten need it, after a timer that is late as few are; without rehearsals where
/// they do not fit. None where nothing was measured.
fn automatic(timer_p90_ns: u64, rehearsal_ns: u64, period_ns: u64) -> Lead {
    if timer_p90_ns == 0 {
        return Lead::default();
    }
    let most_ns = most(period_ns);
    let rehearsal_ns = if rehearsal_ns < most_ns { rehearsal_ns } else { 0 };
    Lead {
        lead_ns: (TIMERS * timer_p90_ns + REHEARSALS * rehearsal_ns + MARGIN_NS).min(most_ns),
        rehearsal_ns,
        timer_p90_ns,
    }
}

/// The longest automatic lead [ns].
fn most(period_ns: u64) -> u64 {
    (period_ns * MOST_PERCENT / 100).min(LONGEST_LEAD_NS)
}

/// The smallest value that `percent` of all do not exceed; 0 of none.
fn quantile(values: &mut [u64], percent: usize) -> u64 {
    values.sort_unstable();
    let rank = (values.len() * percent).div_ceil(100);
    rank.checked_sub(1).and_then(|i| values.get(i)).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::realtime::RealtimeMode;

    fn settings(lead: LeadSetting, rehearse: bool) -> RealtimeSettings {
        RealtimeSettings { mode: RealtimeMode::Prefer, priority: 10, cpu: None, lead, rehearse }
    }

    fn soon() -> Grid {
        Grid { t0_ns: now_ns() + 600_000_000, period_ns: 1_000_000 }
    }

    #[test]
    fn without_a_lead_nothing_is_measured() {
        let refuse = || Err(Error::Interrupted);
        for (lead, is_fifo) in [(LeadSetting::Fixed(0), true), (LeadSetting::Auto, false)] {
            assert_eq!(choose(&settings(lead, true), is_fifo, &soon(), refuse).unwrap(), Lead::default());
        }
        assert!(choose(&settings(LeadSetting::Auto, true), true, &soon(), refuse).is_err(), "and here it is");
    }

    #[test]
    fn a_lead_is_chosen_before_take_off_from_what_was_measured() {
        let mut rehearsed = 0_u64;
        let lead = choose(&settings(LeadSetting::Auto, true), true, &soon(), || {
            rehearsed += 1;
            let until_ns = now_ns() + 50_000;
            while now_ns() < until_ns {}
            Ok(())
        })
        .unwrap();
        assert!(rehearsed > 0 && lead.rehearsal_ns >= 50_000, "{rehearsed} rehearsals, {lead:?}");
        assert!(lead.timer_p90_ns > 0 && lead.lead_ns >= lead.rehearsal_ns.min(250_000), "{lead:?}");
        let fixed = choose(&settings(LeadSetting::Fixed(70_000), false), false, &soon(), || Err(Error::Interrupted));
        let fixed = fixed.unwrap();
        assert_eq!((fixed.lead_ns, fixed.rehearsal_ns), (70_000, 0), "one that is set is kept, and nobody rehearses");
        assert!(fixed.timer_p90_ns > 0, "the report says what it stands beside");
    }

    #[test]
    fn an_automatic_lead_covers_late_timers_and_a_rehearsal_and_leaves_most_of_the_tick() {
        let chosen = |timer, rehearsal, period| {
            let Lead { lead_ns, rehearsal_ns, .. } = automatic(timer, rehearsal, period);
            (lead_ns, rehearsal_ns)
        };
        assert_eq!(chosen(30_000, 35_000, 1_000_000), (170_000, 35_000));
        assert_eq!(chosen(2_000_000, 35_000, 1_000_000), (250_000, 35_000));
        assert_eq!(chosen(10_000, 70_000, 250_000), (40_000, 0), "rehearsals that do not fit are none");
        assert_eq!(automatic(0, 0, 1_000_000), Lead::default(), "a machine that stalled has measured nothing");
    }

    #[test]
    fn quantiles_are_values_that_were_measured() {
        let mut values: Vec<u64> = (1..=100).rev().collect();
        assert_eq!((quantile(&mut values, 90), quantile(&mut values, 99)), (90, 99));
        assert_eq!((quantile(&mut [7], 90), quantile(&mut [], 90)), (7, 0));
    }
}
