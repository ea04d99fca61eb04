//! The active lead: how long before its next tick the plant's timer fires.
//!
//! Kernel timers fire some microseconds late, and rarely much later. A timer that is set ahead by more than that wakes
//! the plant before nearly every tick. In the time that is left all stages do a warm-up run (in code and settings
//! `rehearse`), and the plant polls the clock until the tick begins. A measurement before take-off gives the lead that a
//! flight begins with. In flight an automatic lead adapts in each tick to the lateness of timers and to the time that a
//! warm-up run takes.

use ipc::clock::{now_ns, sleep_until};
use ipc::error::Error;
use messages::grid::Grid;
use messages::realtime::{LONGEST_LEAD_NS, Lead, LeadSetting, RealtimeSettings};
use messages::role::{Channel, Replica, Role};

/// At take-off an automatic lead covers this multiple of the 90th percentile of timer lateness, a figure that rare stalls
/// of the host do not move.
const TIMERS: u64 = 3;
/// And this multiple of the 90th percentile of the warm-up runs' time, so that few in flight lack time.
const REHEARSALS: u64 = 2;
/// In flight it covers the lateness that one timer in this many exceeds.
const TIMERS_LATER: u64 = 100;
/// And the time that one warm-up run in this many exceeds.
const REHEARSALS_LONGER: u64 = 50;
/// Added to both, so that the plant reads the clock at least so long [ns]. It is the least lead: that of a machine
/// whose timers are never late, and which has no warm-up runs.
const MARGIN_NS: u64 = 10_000;
/// Share of the period that an automatic lead takes at most [%], with warm-up runs and without. Without them it only
/// waits: at 8 kHz a quarter of the period would be a third of the loops' processor time.
const MOST_PERCENT: u64 = 25;
const MOST_PERCENT_WAITING: u64 = 10;

/// The other roles are in their loops so long after the plant has said that it will fly [ns].
const IN_LOOPS_NS: u64 = 6_000_000;
/// Longest time between two measurements [ns]: of a slower flight there would be too few.
const EVERY_NS: u64 = 10_000_000;

/// Chooses the lead at the take-off of a flight that begins at `grid.t0_ns`, and returns before then.
///
/// How late timers are on this machine, and how long a warm-up run takes, is measured on the processor of the loops, with
/// all loops there: between their arming and t_0, in ticks of the flight's length that consist of a warm-up run alone.
/// `rehearse` returns when all stages have done theirs.
pub(crate) fn choose(
    settings: &RealtimeSettings,
    is_fifo: bool,
    grid: &Grid,
    mut rehearse: impl FnMut() -> Result<(), Error>,
) -> Result<Lead, Error> {
    if settings.lead == LeadSetting::Fixed(0) || (settings.lead == LeadSetting::Auto && !is_fifo) {
        return Ok(Lead::default());
    }
    let every_ns = grid.period_ns.min(EVERY_NS);
    let longest_ns = longest(settings, grid.period_ns);
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
        // Skip ticks that are over.
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

/// The smallest value that `percent` of all do not exceed; 0 if there are none.
fn quantile(values: &mut [u64], percent: usize) -> u64 {
    values.sort_unstable();
    let rank = (values.len() * percent).div_ceil(100);
    rank.checked_sub(1)
        .and_then(|i| values.get(i))
        .copied()
        .unwrap_or(0)
}

/// The lead of a flight that begins with `timer_p90_ns` and `rehearsal_ns`, the 90th percentiles measured before it.
///
/// Without warm-up runs where they do not fit after a late timer; none where nothing was measured.
fn automatic(timer_p90_ns: u64, rehearsal_ns: u64, period_ns: u64) -> Lead {
    if timer_p90_ns == 0 {
        return Lead::default();
    }
    let longest_ns = most(period_ns, true);
    let fits = rehearsal_ns < longest_ns - timer_p90_ns.min(longest_ns / 2);
    let rehearsal_ns = if fits { rehearsal_ns } else { 0 };
    let most_ns = most(period_ns, rehearsal_ns > 0);
    let lead_ns = (TIMERS * timer_p90_ns + REHEARSALS * rehearsal_ns + MARGIN_NS).min(most_ns);
    Lead {
        lead_ns,
        rehearsal_ns,
        timer_p90_ns,
    }
}

/// The longest lead that a flight with these settings may have [ns].
fn longest(settings: &RealtimeSettings, period_ns: u64) -> u64 {
    match settings.lead {
        LeadSetting::Fixed(ns) => ns,
        LeadSetting::Auto => most(period_ns, settings.rehearse),
    }
}

/// How much of each tick the stages of a channel leave to the plant's lead: nothing, unless the plant preempts them [ns].
pub fn left_by(channel: Channel, settings: &RealtimeSettings, period_ns: u64) -> u64 {
    match Replica::new(Role::Outer, channel).is_below_plant(settings.channel_cpus) {
        true => longest(settings, period_ns),
        false => 0,
    }
}

/// The longest automatic lead [ns].
fn most(period_ns: u64, rehearses: bool) -> u64 {
    let percent = if rehearses {
        MOST_PERCENT
    } else {
        MOST_PERCENT_WAITING
    };
    (period_ns * percent / 100).min(LONGEST_LEAD_NS)
}

/// The lead of the next tick, and the time in it for a warm-up run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActiveLead {
    lead_ns: u64,
    timer: TrackedQuantile,
    /// How long a warm-up run takes; 0 without them.
    rehearsal: TrackedQuantile,
    /// The longest lead that it may become [ns]; `None` where it stays.
    most_ns: Option<u64>,
}

impl ActiveLead {
    pub fn none() -> Self {
        Self::new(&Lead::default(), LeadSetting::Fixed(0), 0)
    }

    /// The lead at take-off. In flight it adapts if it is automatic and not 0.
    pub fn new(at_take_off: &Lead, setting: LeadSetting, period_ns: u64) -> Self {
        let (lead_ns, rehearsal_ns) = (at_take_off.lead_ns, at_take_off.rehearsal_ns);
        let timer_ns = TIMERS * at_take_off.timer_p90_ns;
        let is_automatic = setting == LeadSetting::Auto && lead_ns > 0;
        let most_ns = is_automatic.then(|| most(period_ns, rehearsal_ns > 0));
        let longest_ns = most_ns.unwrap_or(lead_ns);
        Self {
            lead_ns,
            timer: TrackedQuantile::new(timer_ns, TIMERS_LATER, longest_ns),
            rehearsal: TrackedQuantile::new(
                REHEARSALS * rehearsal_ns,
                REHEARSALS_LONGER,
                longest_ns,
            ),
            most_ns,
        }
    }

    /// How far ahead of its tick the timer is set [ns]; 0 is at the tick.
    pub const fn lead_ns(&self) -> u64 {
        self.lead_ns
    }

    /// Whether a warm-up run may begin with so much time left until the tick.
    pub const fn allows_rehearsal(&self, left_ns: u64) -> bool {
        let needs_ns = self.rehearsal.value_ns;
        needs_ns > 0 && left_ns >= needs_ns
    }

    /// Takes what a tick has shown: how late its timer was, and how long its warm-up run took; 0 without one.
    ///
    /// So the time for a warm-up run shrinks in ticks without one, until there is one again.
    pub fn follow(&mut self, timer_late_ns: u64, rehearsal_ns: u64) {
        self.timer.follow(timer_late_ns);
        self.rehearsal.follow(rehearsal_ns);
        if let Some(most_ns) = self.most_ns {
            self.lead_ns = (self.timer.value_ns + self.rehearsal.value_ns + MARGIN_NS).min(most_ns);
        }
    }
}

/// The share of itself by which a quantile grows with a sample beyond it: one part in so many.
const GROWS_BY: u64 = 16;

/// The value that one sample in so many exceeds, of those that came last.
///
/// It grows by 1/16 with a sample above it and shrinks by 1/16/(n-1) with any other, so it settles where one sample in n
/// exceeds it. It doubles after a dozen samples above it, and a stall is one step, however long it was. Below some
/// microseconds it no longer shrinks, because it counts in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TrackedQuantile {
    value_ns: u64,
    one_in: u64,
    most_ns: u64,
}

impl TrackedQuantile {
    /// One that begins at `start_ns`, is exceeded by one sample in `one_in`, which is at least two, and never exceeds
    /// `most_ns`.
    fn new(start_ns: u64, one_in: u64, most_ns: u64) -> Self {
        Self {
            value_ns: start_ns.min(most_ns),
            one_in,
            most_ns,
        }
    }

    /// Takes a sample [ns].
    fn follow(&mut self, sample_ns: u64) {
        self.value_ns = if sample_ns > self.value_ns {
            (self.value_ns + self.value_ns.div_ceil(GROWS_BY)).min(self.most_ns)
        } else {
            self.value_ns - self.value_ns / (GROWS_BY * (self.one_in - 1))
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::clock::busy_wait;
    use messages::realtime::RealtimeMode;

    const PERIOD_NS: u64 = 1_000_000;
    const BEFORE: (u64, u64) = (20_000, 30_000);

    fn automatic_lead() -> ActiveLead {
        let (timer_p90_ns, rehearsal_ns) = BEFORE;
        ActiveLead::new(
            &automatic(timer_p90_ns, rehearsal_ns, PERIOD_NS),
            LeadSetting::Auto,
            PERIOD_NS,
        )
    }

    /// Flies ticks whose timers are late by the samples in turn, and counts those that were rehearsed.
    fn fly(lead: &mut ActiveLead, ticks: usize, timers_ns: &[u64], rehearsal_ns: u64) -> usize {
        let timers = timers_ns.iter().cycle().take(ticks);
        timers
            .filter(|late_ns| {
                let is_rehearsed = lead.allows_rehearsal(lead.lead_ns().saturating_sub(**late_ns));
                lead.follow(**late_ns, if is_rehearsed { rehearsal_ns } else { 0 });
                is_rehearsed
            })
            .count()
    }

    #[test]
    fn an_automatic_lead_covers_late_timers_and_a_rehearsal_and_leaves_most_of_the_tick() {
        let chosen = |timer, rehearsal, period| {
            let Lead {
                lead_ns,
                rehearsal_ns,
                ..
            } = automatic(timer, rehearsal, period);
            (lead_ns, rehearsal_ns)
        };
        assert_eq!(chosen(30_000, 35_000, 1_000_000), (170_000, 35_000));
        assert_eq!(chosen(2_000_000, 35_000, 1_000_000), (250_000, 35_000));
        // Warm-up runs that do not fit are left out.
        assert_eq!(chosen(10_000, 70_000, 250_000), (25_000, 0));
        assert_eq!(chosen(10_000, 25_000, 125_000), (12_500, 0));
        for rehearse in [true, false] {
            let rehearsal_ns = if rehearse { 35_000 } else { 0 };
            let longest_ns = longest(&settings(LeadSetting::Auto, rehearse), 1_000_000);
            let lead_ns = automatic(2_000_000, rehearsal_ns, 1_000_000).lead_ns;
            assert!(lead_ns <= longest_ns && longest_ns <= 250_000);
        }
        // A machine that stalled has measured nothing.
        assert_eq!(automatic(0, 0, 1_000_000), Lead::default());
    }

    #[test]
    fn it_follows_the_machine_to_longer_and_shorter_leads_and_rehearses_most_ticks() {
        let mut lead = automatic_lead();
        assert_eq!(lead.lead_ns(), 3 * 20_000 + 2 * 30_000 + 10_000);
        let quiet: Vec<u64> = (0..97).map(|i| 5_000 + i * 37 % 97 * 100).collect();
        let disturbed: Vec<u64> = quiet.iter().map(|ns| ns * 6).collect();
        fly(&mut lead, 5_000, &quiet, 20_000);
        let quiet_ns = lead.lead_ns();
        assert!(
            (44_000..50_000).contains(&quiet_ns),
            "15 and 20 and 10 us: {quiet_ns}"
        );
        assert!(fly(&mut lead, 1_000, &quiet, 20_000) >= 980);
        fly(&mut lead, 1_000, &disturbed, 40_000);
        let disturbed_ns = lead.lead_ns();
        assert!(
            (135_000..150_000).contains(&disturbed_ns),
            "87 and 40 and 10 us: {disturbed_ns}"
        );
        assert!(fly(&mut lead, 1_000, &disturbed, 40_000) >= 980);
        fly(&mut lead, 5_000, &quiet, 20_000);
        assert!(lead.lead_ns().abs_diff(quiet_ns) < 5_000);
    }

    #[test]
    fn it_never_takes_more_than_its_share_of_the_period_and_comes_back_from_there() {
        let mut lead = automatic_lead();
        fly(&mut lead, 2_000, &[20_000_000], 30_000);
        assert_eq!(lead.lead_ns(), PERIOD_NS / 4);
        fly(&mut lead, 4_000, &[10_000], 300_000);
        assert!(lead.lead_ns() <= PERIOD_NS / 4, "{lead:?}");
        // Warm-up runs that were too long are tried again.
        assert!(fly(&mut lead, 6_000, &[10_000], 30_000) > 4_000);
        assert!(lead.lead_ns() < 60_000, "{lead:?}");
        let slow = automatic(30_000, 30_000, 100_000_000);
        let mut slow = ActiveLead::new(&slow, LeadSetting::Auto, 100_000_000);
        fly(&mut slow, 2_000, &[u64::MAX], 0);
        assert_eq!(slow.lead_ns(), LONGEST_LEAD_NS);
        // Nor less than its margin.
        let least = automatic(1, 0, PERIOD_NS);
        let mut least = ActiveLead::new(&least, LeadSetting::Auto, PERIOD_NS);
        assert_eq!(fly(&mut least, 10_000, &[0], 0), 0);
        assert!((MARGIN_NS..=MARGIN_NS + 3).contains(&least.lead_ns()));
    }

    #[test]
    fn a_lead_that_is_set_stays_and_its_rehearsals_are_given_what_they_take() {
        let at_take_off = Lead {
            lead_ns: 100_000,
            rehearsal_ns: 60_000,
            timer_p90_ns: 20_000,
        };
        let mut lead = ActiveLead::new(&at_take_off, LeadSetting::Fixed(100_000), PERIOD_NS);
        assert!(fly(&mut lead, 2_000, &[30_000], 50_000) > 1_400, "{lead:?}");
        assert_eq!(lead.lead_ns(), 100_000);
        assert!(lead.allows_rehearsal(60_000) && !lead.allows_rehearsal(40_000));
        let mut none = ActiveLead::none();
        assert_eq!(fly(&mut none, 100, &[30_000], 50_000), 0);
        let mut no_fifo = ActiveLead::new(&Lead::default(), LeadSetting::Auto, PERIOD_NS);
        no_fifo.follow(30_000, 0);
        // What is none stays none.
        assert_eq!((none.lead_ns(), no_fifo.lead_ns()), (0, 0));
    }

    /// Numbers that repeat after a prime number of them, evenly spread over 0 to 1.
    fn spread(i: u64) -> f64 {
        (i * 7919 % 9973) as f64 / 9973.0
    }

    #[test]
    fn it_settles_so_that_its_share_lies_beyond_wherever_it_began() {
        // Even, with a long tail, and of two kinds.
        let series: [fn(f64) -> f64; 3] = [
            |x| 100_000.0 * x,
            |x| 8_000.0 / (1.0 - x).sqrt(),
            |x| {
                if x < 0.9 {
                    12_000.0
                } else {
                    30_000.0 + 40_000.0 * x
                }
            },
        ];
        for sample in series {
            for (one_in, start_ns) in [(10, 30_000), (50, 1_000), (100, 4_000_000)] {
                let mut tracked = TrackedQuantile::new(start_ns, one_in, 5_000_000);
                let mut beyond = 0;
                for i in 0..70_000 {
                    let sample_ns = sample(spread(i)) as u64;
                    beyond += u64::from(i >= 20_000 && sample_ns > tracked.value_ns);
                    tracked.follow(sample_ns);
                }
                let share = 50_000.0 / (beyond * one_in) as f64;
                assert!(share > 0.9 && share < 1.2, "{share} of one in {one_in}");
            }
        }
    }

    #[test]
    fn a_quantile_doubles_after_a_dozen_late_samples_and_forgets_a_single_stall() {
        for one_in in [50, 100] {
            let mut tracked = TrackedQuantile::new(40_000, one_in, 250_000);
            tracked.follow(20_000_000);
            assert_eq!(tracked.value_ns, 42_500, "one step, however long it was");
            (0..one_in).for_each(|_| tracked.follow(10_000));
            assert!((39_000..40_500).contains(&tracked.value_ns), "{tracked:?}");
            tracked.value_ns = 40_000;
            (0..11).for_each(|_| tracked.follow(200_000));
            assert!(tracked.value_ns < 80_000, "{tracked:?}");
            tracked.follow(200_000);
            assert!(tracked.value_ns >= 80_000, "{tracked:?}");
        }
        for (start_ns, expected_ns) in [(0, 0), (1, 9_000)] {
            let mut tracked = TrackedQuantile::new(start_ns, 100, 250_000);
            (0..200).for_each(|_| tracked.follow(10_000));
            assert!(tracked.value_ns >= expected_ns && (start_ns > 0 || tracked.value_ns == 0));
        }
    }

    fn settings(lead: LeadSetting, rehearse: bool) -> RealtimeSettings {
        RealtimeSettings {
            mode: RealtimeMode::Prefer,
            priority: 10,
            lead,
            rehearse,
            ..RealtimeSettings::OFF
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
            busy_wait(50_000);
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
        // A lead that is set is kept, and there is no warm-up run.
        assert_eq!((fixed.lead_ns, fixed.rehearsal_ns), (70_000, 0));
        // The report says what it stands beside.
        assert!(fixed.timer_p90_ns > 0);
    }

    #[test]
    fn a_quantile_is_the_smallest_value_that_its_share_does_not_exceed() {
        let mut hundred: Vec<u64> = (1..=100).rev().collect();
        assert_eq!(
            [50, 90, 99].map(|it| quantile(&mut hundred, it)),
            [50, 90, 99]
        );
        assert_eq!((quantile(&mut [7], 90), quantile(&mut [], 90)), (7, 0));
    }
}
