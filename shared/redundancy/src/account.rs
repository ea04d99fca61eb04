//! Counts what each channel contributed to a flight: handovers, outages, comparisons of commands.

use messages::channels::{OUTAGES_KEPT, Outage, OutageReason, Redundancy, Switchover};
use messages::role::{Channel, MOST_CHANNELS};

use crate::selection::{Arrangement, Candidate, Selection, largest_difference};

/// Keeps the account, tick by tick.
#[derive(Clone, Copy, Debug)]
pub struct RedundancyAccount {
    pub redundancy: Redundancy,
    arrangement: Arrangement,
    /// Place of each channel's present outage among those that are kept.
    open: [Option<usize>; MOST_CHANNELS],
    unprotected_run: u64,
}

impl RedundancyAccount {
    pub fn new(arrangement: Arrangement) -> Self {
        Self {
            redundancy: Redundancy {
                channels: arrangement.channels as u64,
                ..Redundancy::default()
            },
            arrangement,
            open: [None; MOST_CHANNELS],
            unprotected_run: 0,
        }
    }

    /// Enters that another group flies from a tick on.
    pub fn switch(&mut self, switchover: Switchover) {
        let account = &mut self.redundancy;
        if let Some(place) = account
            .switchovers
            .get_mut(account.switchover_count as usize)
        {
            *place = switchover;
        }
        account.switchover_count += 1;
    }

    /// Enters a tick that a group flew, with the commands that there were when one was selected.
    pub fn enter(
        &mut self,
        tick: u64,
        candidates: &[Candidate],
        group: Channel,
        selection: Option<Selection>,
    ) {
        let flown_before = self.redundancy.active;
        self.enter_outages(tick, candidates, group, selection);
        let account = &mut self.redundancy;
        let Some(selection) = selection else {
            account.not_fresh += 1;
            return;
        };
        let chosen = &selection.chosen;
        let active = chosen.channel as u64;
        account.handovers += u64::from(active != flown_before);
        account.active = active;
        account.flown[chosen.channel as usize] += 1;
        account.not_fresh += u64::from(!chosen.is_usable());
        account.masked += u64::from(chosen.is_usable() && chosen.channel != group);
        account.votes += u64::from(selection.is_compared);
        if selection.differs {
            if account.mismatches == 0 {
                account.first_mismatch = tick;
            }
            account.mismatches += 1;
        }
        if let Some(outvoted) = selection.outvoted {
            account.outvoted[outvoted as usize] += 1;
        }
        if chosen.is_usable() {
            self.enter_differences(candidates, chosen);
        }
    }

    /// Enters the channels without a usable command, and whether another one could have flown.
    fn enter_outages(
        &mut self,
        tick: u64,
        candidates: &[Candidate],
        group: Channel,
        selection: Option<Selection>,
    ) {
        let arrangement = self.arrangement;
        let mut usable = 0;
        let outvoted = selection.and_then(|it| it.outvoted);
        for channel in Channel::first(self.redundancy.channels as usize) {
            let candidate = candidates.iter().find(|it| it.channel == channel);
            let reason = match candidate {
                None => Some(OutageReason::Missing),
                Some(it) if !it.is_on_time() => Some(OutageReason::Late),
                Some(it) if !it.is_fresh => Some(OutageReason::Stale),
                Some(_) if outvoted == Some(channel) => Some(OutageReason::Outvoted),
                Some(_) => None,
            };
            let can_fly = arrangement.simplex.is_some() || arrangement.group(channel) == group;
            usable += u64::from(reason.is_none() && can_fly);
            let place = channel as usize;
            let Some(reason) = reason else {
                self.open[place] = None;
                continue;
            };
            let outage = self.open[place].unwrap_or_else(|| {
                self.keep(Outage {
                    channel: place as u64,
                    tick,
                    ticks: 0,
                    reason: reason as u64,
                    is_handover: 0,
                })
            });
            self.open[place] = Some(outage);
            let flew = self.redundancy.active == place as u64;
            let outage = &mut self.redundancy.outages[outage];
            outage.ticks += 1;
            // Its command may be flown for longer than it is usable.
            if flew && selection.is_some_and(|it| it.chosen.channel != channel) {
                outage.is_handover = 1;
            }
        }
        self.unprotected_run = if usable < 2 {
            self.unprotected_run + 1
        } else {
            0
        };
        let account = &mut self.redundancy;
        account.unprotected += u64::from(usable < 2);
        account.longest_unprotected = account.longest_unprotected.max(self.unprotected_run);
    }

    /// Keeps an outage that begins, and returns its place. Where all places are taken, the shortest outage that is over is
    /// left out; of equals a handover is kept longer, then the earlier one.
    fn keep(&mut self, outage: Outage) -> usize {
        let account = &mut self.redundancy;
        let mut place = account.outage_count as usize;
        account.outage_count += 1;
        if place >= OUTAGES_KEPT {
            let over = (0..OUTAGES_KEPT).rev();
            let over = over.filter(|it| !self.open.contains(&Some(*it)));
            let weight =
                |it: &usize| (account.outages[*it].ticks, account.outages[*it].is_handover);
            let least = over.min_by_key(weight).unwrap_or(0);
            account.outages[least..].rotate_left(1);
            for open in self.open.iter_mut().flatten() {
                *open -= usize::from(*open > least);
            }
            place = OUTAGES_KEPT - 1;
        }
        account.outages[place] = outage;
        place
    }

    /// Enters by how much usable commands of other laws differ from the one that was chosen.
    fn enter_differences(&mut self, candidates: &[Candidate], chosen: &Candidate) {
        let (account, arrangement) = (&mut self.redundancy, self.arrangement);
        for other in candidates.iter().filter(|it| it.is_usable()) {
            if !arrangement.are_alike(other.channel, chosen.channel) {
                let place = other.channel as usize;
                let difference =
                    largest_difference(&other.command.speed_rad_s, &chosen.command.speed_rad_s);
                account.compared[place] += 1;
                account.difference_max_rad_s[place] =
                    account.difference_max_rad_s[place].max(difference);
                account.difference_square_sum_rad2_s2[place] += difference * difference;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selection::select;
    use crate::selection::tests::candidate;

    #[test]
    fn the_account_has_outages_handovers_and_the_time_without_redundancy() {
        use Channel::{A, B};
        let mut account = RedundancyAccount::new(Arrangement::alike(2));
        let usable = |channel| candidate(channel, true, true, 1.0);
        for tick in 0..20 {
            let mut candidates = vec![usable(A), usable(B)];
            match tick {
                5..8 => _ = candidates.remove(0),
                10 => candidates[1].is_fresh = false,
                15 => candidates.clear(),
                _ => {}
            }
            account.enter(tick, &candidates, A, select(&candidates));
        }
        let it = &account.redundancy;
        assert_eq!((it.flown, it.masked, it.not_fresh), ([16, 3, 0], 3, 1));
        assert_eq!((it.unprotected, it.longest_unprotected), (5, 3));
        assert_eq!((it.handovers, it.active, it.mismatches), (2, 0, 0));
        let outages = &it.outages[..it.outage_count as usize];
        let found: Vec<_> = outages
            .iter()
            .map(|it| (it.channel, it.tick, it.ticks, it.reason, it.is_handover))
            .collect();
        let expected = [
            (0, 5, 3, 0, 1),
            (1, 10, 1, 2, 0),
            (0, 15, 1, 0, 0),
            (1, 15, 1, 0, 0),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_handover_is_that_of_the_outage_also_where_another_channel_can_fly_only_later() {
        use Channel::{A, B};
        let mut account = RedundancyAccount::new(Arrangement::alike(2));
        let usable = |channel| candidate(channel, true, true, 1.0);
        let stale = |channel| candidate(channel, true, false, 1.0);
        for (tick, candidates) in [
            vec![usable(A), usable(B)],
            vec![stale(A), stale(B)],
            vec![stale(A), usable(B)],
            vec![stale(A), usable(B)],
        ]
        .into_iter()
        .enumerate()
        {
            account.enter(tick as u64, &candidates, A, select(&candidates));
        }
        let it = &account.redundancy;
        let outages = it.outages[..2].iter();
        let outages: Vec<_> = outages
            .map(|it| (it.channel, it.ticks, it.is_handover))
            .collect();
        assert_eq!((it.handovers, outages), (1, vec![(0, 3, 1), (1, 1, 0)]));
    }

    #[test]
    fn the_longest_outages_are_kept_however_many_come_before_and_after_them() {
        use Channel::{A, B};
        let mut account = RedundancyAccount::new(Arrangement::alike(2));
        let usable = |channel| candidate(channel, true, true, 1.0);
        for tick in 0..1000 {
            let mut candidates = vec![usable(A), usable(B)];
            match tick {
                400..450 => _ = candidates.remove(0),
                // The other channel stays out while its entry moves up.
                600..700 => candidates[1].is_fresh = false,
                _ => {}
            }
            if tick % 2 == 1 && !(400..450).contains(&tick) {
                candidates.remove(0);
            }
            account.enter(tick, &candidates, A, select(&candidates));
        }
        let it = &account.redundancy;
        assert_eq!(it.outage_count, 476);
        assert!(it.outages.is_sorted_by_key(|it| it.tick));
        let longer = it.outages.iter().filter(|it| it.ticks > 1);
        let longer: Vec<_> = longer.map(|it| (it.channel, it.tick, it.ticks)).collect();
        assert_eq!(longer, [(0, 399, 51), (1, 600, 100)]);
        let ends = [0, 1, OUTAGES_KEPT - 1].map(|place| it.outages[place].tick);
        assert_eq!(ends, [1, 3, 999]);
    }
}
