//! Redundant channels: whose command of a tick is flown, and what the plant notes of it.

use std::cmp::Reverse;

use crate::content::RotorSpeeds;
use crate::header::Message;
use crate::layout::{Visit as _, layout, wire_enum, zeroed};
use crate::role::{Channel, MOST_CHANNELS, Role};

/// Name of the plant's blackboard with the [`Redundancy`].
pub const REDUNDANCY: &str = "redundancy";

/// A channel's command of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    pub channel: Channel,
    pub tick: u64,
    /// Tick from which on it may act: the next one, if it was sent before that began.
    pub effective_tick: u64,
    /// Whether every stage computed it from the state of the tick.
    pub is_fresh: bool,
    pub command: RotorSpeeds,
}

impl Candidate {
    /// A command that may act from a tick on; none of the last one of a mixer, which answers no wrench.
    pub fn of(
        channel: Channel,
        message: &Message<RotorSpeeds>,
        effective_tick: u64,
    ) -> Option<Self> {
        let Message { envelope, content } = message;
        (envelope.stamps_of(Role::Mixer).receive_ns > 0).then(|| Self {
            channel,
            tick: envelope.tick,
            effective_tick,
            is_fresh: envelope.input_tick == [envelope.tick; 3],
            command: *content,
        })
    }

    const fn is_on_time(&self) -> bool {
        self.effective_tick == self.tick + 1
    }

    const fn is_usable(&self) -> bool {
        self.is_on_time() && self.is_fresh
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Place of the command that is flown among the candidates.
    pub chosen: usize,
    /// Whether two usable commands differ in a bit.
    pub differs: bool,
    /// The channel that two others contradict.
    pub outvoted: Option<Channel>,
}

/// Chooses the command of a tick: one that may act earlier before any other, then one that is fresh, that of the majority if
/// three are alike in that and one differs, and then that of the first channel. The candidates are in the order of their
/// channels.
pub fn select(candidates: &[Candidate]) -> Option<Selection> {
    let rank = |it: &Candidate| (Reverse(it.effective_tick), it.is_fresh);
    let best = candidates.iter().map(rank).max()?;
    let same = |a: &Candidate, b: &Candidate| a.command.is_same(&b.command);
    let rivals = || candidates.iter().filter(|it| rank(it) == best);
    let is_contradicted = |it: &Candidate| {
        let others = || rivals().filter(|other| other.channel != it.channel);
        others().count() == 2 && !others().any(|other| same(it, other))
    };
    let chosen = |it: &Candidate| rank(it) == best && !is_contradicted(it);
    let first = |it: &Candidate| rank(it) == best;
    let place = candidates.iter().position(chosen);
    // Where all three differ, none has a majority.
    let chosen = place.or_else(|| candidates.iter().position(first))?;
    let is_usable = candidates[chosen].is_usable();
    let differs = is_usable && rivals().any(|it| !same(it, &candidates[chosen]));
    let outvoted = rivals().find(|it| place.is_some() && differs && is_contradicted(it));
    Some(Selection {
        chosen,
        differs,
        outvoted: outvoted.map(|it| it.channel),
    })
}

wire_enum! {
    /// Why a channel had no command that could be flown.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[repr(u64)]
    pub enum OutageReason {
        Missing = 0 => "no command",
        Late = 1 => "late",
        Stale = 2 => "not computed from the tick's state",
        Outvoted = 3 => "contradicted by two channels",
    }
}

layout! {
    /// Ticks in a row for which a channel had no command that could be flown.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    #[repr(C)]
    pub struct Outage {
        /// Place of the channel among [`Channel::ALL`].
        pub channel: u64,
        /// The first tick without a command.
        pub tick: u64,
        pub ticks: u64,
        /// An [`OutageReason`] as number: that of the first tick.
        pub reason: u64,
        /// 1 where the channel flew until then, so that another one took over.
        pub is_handover: u64,
    }
}

/// Outages that are kept each; later ones are only counted.
pub const OUTAGES_KEPT: usize = 64;

layout! {
    /// The plant's account of the channels.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[repr(C)]
    pub struct Redundancy {
        pub channels: u64,
        /// Place of the channel whose command is in force.
        pub active: u64,
        /// Ticks whose command was each channel's.
        pub flown: [u64; MOST_CHANNELS],
        /// Ticks for which fewer than two channels had a command that could be flown.
        pub unprotected: u64,
        pub longest_unprotected: u64,
        /// Ticks in which another channel than a had the fresh command on time that was flown.
        pub masked: u64,
        /// Ticks without a fresh command on time from any channel.
        pub not_fresh: u64,
        /// Ticks in which two fresh commands differed.
        pub mismatches: u64,
        /// The first of them.
        pub first_mismatch: u64,
        /// Ticks in which two channels contradicted each channel.
        pub outvoted: [u64; MOST_CHANNELS],
        /// Times that another channel's command was flown than in the tick before.
        pub handovers: u64,
        pub outage_count: u64,
        pub outages: [Outage; OUTAGES_KEPT],
    }
}

impl Default for Redundancy {
    fn default() -> Self {
        zeroed()
    }
}

/// Keeps the account, tick by tick.
#[derive(Clone, Copy, Debug)]
pub struct RedundancyAccount {
    pub redundancy: Redundancy,
    /// Place of each channel's present outage among those that are counted.
    open: [Option<u64>; MOST_CHANNELS],
    unprotected_run: u64,
}

impl RedundancyAccount {
    pub fn new(channels: usize) -> Self {
        Self {
            redundancy: Redundancy {
                channels: channels as u64,
                ..Redundancy::default()
            },
            open: [None; MOST_CHANNELS],
            unprotected_run: 0,
        }
    }

    /// Enters a tick: what there was of it when its command was chosen.
    pub fn enter(&mut self, tick: u64, candidates: &[Candidate], selection: Option<Selection>) {
        let account = &mut self.redundancy;
        let flown_before = account.active;
        let mut usable = 0;
        let outvoted = selection.and_then(|it| it.outvoted);
        for channel in Channel::first(account.channels as usize) {
            let candidate = candidates.iter().find(|it| it.channel == channel);
            let reason = match candidate {
                None => Some(OutageReason::Missing),
                Some(it) if !it.is_on_time() => Some(OutageReason::Late),
                Some(it) if !it.is_fresh => Some(OutageReason::Stale),
                Some(_) if outvoted == Some(channel) => Some(OutageReason::Outvoted),
                Some(_) => None,
            };
            usable += u64::from(reason.is_none());
            let place = channel as usize;
            let Some(reason) = reason else {
                self.open[place] = None;
                continue;
            };
            let number = *self.open[place].get_or_insert_with(|| {
                account.outage_count += 1;
                account.outage_count - 1
            });
            if let Some(outage) = account.outages.get_mut(number as usize) {
                if outage.ticks == 0 {
                    *outage = Outage {
                        channel: place as u64,
                        tick,
                        ticks: 0,
                        reason: reason as u64,
                        is_handover: u64::from(flown_before == place as u64),
                    };
                }
                outage.ticks += 1;
            }
        }
        self.unprotected_run = if usable < 2 {
            self.unprotected_run + 1
        } else {
            0
        };
        account.unprotected += u64::from(usable < 2);
        account.longest_unprotected = account.longest_unprotected.max(self.unprotected_run);
        let Some(selection) = selection else {
            account.not_fresh += 1;
            return;
        };
        let chosen = &candidates[selection.chosen];
        let active = chosen.channel as u64;
        account.handovers += u64::from(active != flown_before);
        account.active = active;
        account.flown[chosen.channel as usize] += 1;
        account.not_fresh += u64::from(!chosen.is_usable());
        account.masked += u64::from(chosen.is_usable() && chosen.channel != Channel::A);
        if selection.differs {
            if account.mismatches == 0 {
                account.first_mismatch = tick;
            }
            account.mismatches += 1;
        }
        if let Some(outvoted) = selection.outvoted {
            account.outvoted[outvoted as usize] += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(channel: Channel, is_on_time: bool, is_fresh: bool, thrust_n: f64) -> Candidate {
        let command = RotorSpeeds {
            thrust_n,
            ..RotorSpeeds::default()
        };
        Candidate {
            channel,
            tick: 7,
            effective_tick: if is_on_time { 8 } else { 9 },
            is_fresh,
            command,
        }
    }

    #[test]
    fn a_fresh_command_on_time_wins_and_of_three_the_majority() {
        use Channel::{A, B, C};
        let usable = |channel, thrust_n| candidate(channel, true, true, thrust_n);
        for (candidates, expected) in [
            (vec![], None),
            (vec![usable(A, 1.0), usable(B, 1.0)], Some((A, false, None))),
            (vec![usable(B, 1.0)], Some((B, false, None))),
            (
                vec![candidate(A, true, false, 2.0), usable(B, 1.0)],
                Some((B, false, None)),
            ),
            (
                vec![candidate(A, false, true, 1.0), usable(B, 1.0)],
                Some((B, false, None)),
            ),
            (
                vec![
                    candidate(A, true, false, 2.0),
                    candidate(B, false, true, 1.0),
                ],
                Some((A, false, None)),
            ),
            // Two that differ: either may be wrong.
            (vec![usable(A, 1.0), usable(B, 2.0)], Some((A, true, None))),
            (
                vec![usable(A, 2.0), usable(B, 1.0), usable(C, 1.0)],
                Some((B, true, Some(A))),
            ),
            (
                vec![usable(A, 1.0), usable(B, 1.0), usable(C, 2.0)],
                Some((A, true, Some(C))),
            ),
            (
                vec![usable(A, 1.0), usable(B, 2.0), usable(C, 3.0)],
                Some((A, true, None)),
            ),
            // A zero of the other sign is another bit.
            (vec![usable(A, 0.0), usable(B, -0.0)], Some((A, true, None))),
        ] {
            let selected = select(&candidates);
            let found = selected.map(|it| (candidates[it.chosen].channel, it.differs, it.outvoted));
            assert_eq!(found, expected, "{candidates:?}");
        }
    }

    #[test]
    fn the_account_has_outages_handovers_and_the_time_without_redundancy() {
        use Channel::{A, B};
        let mut account = RedundancyAccount::new(2);
        let usable = |channel| candidate(channel, true, true, 1.0);
        for tick in 0..20 {
            let mut candidates = vec![usable(A), usable(B)];
            match tick {
                5..8 => _ = candidates.remove(0),
                10 => candidates[1].is_fresh = false,
                15 => candidates.clear(),
                _ => {}
            }
            account.enter(tick, &candidates, select(&candidates));
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
            (0, 15, 1, 0, 1),
            (1, 15, 1, 0, 0),
        ];
        assert_eq!(found, expected);
    }
}
