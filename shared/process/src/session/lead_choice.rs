//! The measurement before take-off that gives the lead with which a flight begins.
//!
//! A timer of the kernel is late by some microseconds, and now and then by many. Set ahead by more than that, it wakes
//! the plant before the tick in all but a few cases. The plant rehearses in the time that is left, and reads the clock
//! until the tick begins. How late timers are on this machine, and how long a rehearsal takes, is measured on the
//! processor of the loops, with all loops there: between their arming and t_0, in ticks of the flight's length that are
//! only rehearsed.
//! [`crate::lead`] knows what follows from it.

use crate::lead::{automatic, most};
use ipc::clock::{now_ns, sleep_until};
use ipc::error::Error;
use messages::grid::Grid;
use messages::realtime::{Lead, LeadSetting, RealtimeSettings};

/// The other roles are in their loops so long after the plant has said that it will fly [ns].
const IN_LOOPS_NS: u64 = 6_000_000;
/// Longest time between two measurements [ns]: of a slower flight there would be too few.
const EVERY_NS: u64 = 10_000_000;

/// Chooses the lead at the take-off of a flight that begins at `grid.t0_ns`, and returns before then.
///
/// `rehearse` has all stages rehearse, and returns when they have.
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
        LeadSetting::Fixed(lead_ns) => Lead {
            lead_ns,
            rehearsal_ns,
            timer_p90_ns,
        },
        LeadSetting::Auto => automatic(timer_p90_ns, rehearsal_ns, grid.period_ns),
    })
}

/// The smallest value that `percent` of all do not exceed; 0 of none.
fn quantile(values: &mut [u64], percent: usize) -> u64 {
    values.sort_unstable();
    let rank = (values.len() * percent).div_ceil(100);
    rank.checked_sub(1)
        .and_then(|i| values.get(i))
        .copied()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::realtime::RealtimeMode;

    fn settings(lead: LeadSetting, rehearse: bool) -> RealtimeSettings {
        RealtimeSettings {
            mode: RealtimeMode::Prefer,
            priority: 10,
            cpu: None,
            lead,
            rehearse,
        }
    }

    fn soon() -> Grid {
        Grid {
            t0_ns: now_ns() + 600_000_000,
            period_ns: 1_000_000,
        }
    }

    #[test]
    fn without_a_lead_nothing_is_measured() {
        let refuse = || Err(Error::Interrupted);
        for (lead, is_fifo) in [(LeadSetting::Fixed(0), true), (LeadSetting::Auto, false)] {
            assert_eq!(
                choose(&settings(lead, true), is_fifo, &soon(), refuse).unwrap(),
                Lead::default()
            );
        }
        // And here it is.
        assert!(choose(&settings(LeadSetting::Auto, true), true, &soon(), refuse).is_err());
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
        assert!(rehearsed > 0 && lead.rehearsal_ns >= 50_000);
        assert!(lead.timer_p90_ns > 0 && lead.lead_ns >= lead.rehearsal_ns.min(250_000));
        let fixed = choose(
            &settings(LeadSetting::Fixed(70_000), false),
            false,
            &soon(),
            || Err(Error::Interrupted),
        );
        let fixed = fixed.unwrap();
        // A lead that is set is kept, and no stage rehearses.
        assert_eq!((fixed.lead_ns, fixed.rehearsal_ns), (70_000, 0));
        // The report says what it stands beside.
        assert!(fixed.timer_p90_ns > 0);
    }
}
