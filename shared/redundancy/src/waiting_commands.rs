//! Which channel's command of a tick is taken: decided when the next tick begins, with what has come by then.
//!
//! There is no timeout and no failure detector: a chain needs a small part of a tick, and every command has until the next
//! tick begins. The rules are those of [`GroupSelection`]. A flight with one channel follows the same path.

use heapless::Vec;
use messages::channels::Redundancy;
use messages::content::RotorSpeeds;
use messages::header::Message;
use messages::role::{Channel, MOST_CHANNELS};

use crate::account::RedundancyAccount;
use crate::selection::{Arrangement, Candidate, Excursion, GroupSelection};

/// Commands of a tick, in the order of their channels.
type Candidates = Vec<Candidate, MOST_CHANNELS>;

#[derive(Clone, Debug)]
pub struct ChannelSelection {
    /// Commands that wait, with one place for each tick and channel. A tick's row is its number modulo the number of rows.
    waiting: std::vec::Vec<[Option<Candidate>; MOST_CHANNELS]>,
    /// No command of an earlier tick waits.
    next: u64,
    /// The tick whose state was published last, and whose commands are decided on next.
    published: u64,
    /// The first tick whose command has not been taken: a command that comes late may still be needed.
    untaken: u64,
    groups: GroupSelection,
    /// The channel that was requested to fly, and the first tick whose command is to be its.
    requested: Option<(u64, Channel)>,
    /// The commands of the last tick.
    last: Candidates,
    account: RedundancyAccount,
}

impl ChannelSelection {
    /// One in which the commands of `ticks` ticks can wait.
    pub fn new(arrangement: Arrangement, ticks: usize) -> Self {
        Self {
            waiting: vec![[None; MOST_CHANNELS]; ticks],
            next: 0,
            published: 0,
            untaken: 0,
            groups: GroupSelection::new(arrangement),
            requested: None,
            last: Vec::new(),
            account: RedundancyAccount::new(arrangement),
        }
    }

    pub const fn redundancy(&self) -> &Redundancy {
        &self.account.redundancy
    }

    pub const fn arrangement(&self) -> &Arrangement {
        &self.groups.arrangement
    }

    /// Whether a channel's laws can fly: a channel with them had a fresh command of the last tick on time.
    pub fn is_ready(&self, channel: Channel) -> bool {
        self.groups.is_ready(channel, &self.last)
    }

    /// Requests that the command of a tick, and those after it, are of this channel's laws.
    pub const fn request(&mut self, from: u64, channel: Channel) {
        self.requested = Some((from, channel));
    }

    /// Takes a channel's command, which may act from `effective_tick` on. Returns the command if it is refused, because one
    /// of another tick is in its place.
    pub fn offer(
        &mut self,
        channel: Channel,
        message: &Message<RotorSpeeds>,
        effective_tick: u64,
    ) -> Option<Candidate> {
        let candidate = Candidate::of(channel, message, effective_tick)?;
        let rows = self.waiting.len();
        let place = &mut self.waiting[candidate.tick as usize % rows][channel as usize];
        if place.is_some_and(|other| other.tick != candidate.tick) {
            return Some(candidate);
        }
        *place = Some(candidate);
        self.next = self.next.min(candidate.tick);
        None
    }

    /// Decides on the commands of all ticks before `tick`, which begins now, and gives those that are taken to `take`, in
    /// the order of their ticks. Nothing is counted for ticks without a state, of which the last one has `excursion`.
    pub fn decide(&mut self, tick: u64, excursion: &Excursion, mut take: impl FnMut(&Candidate)) {
        let mut published = (self.published < tick).then_some(self.published);
        self.published = tick;
        for made_for in self.next..tick {
            let candidates = self.waiting_of(made_for);
            let is_published = published.take_if(|it| *it == made_for).is_some();
            if candidates.is_empty() && !is_published {
                continue;
            }
            if is_published {
                self.switch(made_for, &candidates, excursion);
            }
            let group = self.groups.group_at(made_for);
            let selection = self.groups.of_group(group, &candidates);
            if let Some(selection) = &selection {
                self.groups.fly(selection);
            }
            if is_published {
                self.account.enter(made_for, &candidates, group, selection);
                self.last = candidates;
            }
            if let Some(selection) = selection.filter(|_| made_for >= self.untaken) {
                take(&selection.chosen);
                self.untaken = made_for + 1;
            }
        }
        self.next = tick;
    }

    fn waiting_of(&mut self, tick: u64) -> Candidates {
        let rows = self.waiting.len();
        let row = self.waiting[tick as usize % rows].iter_mut();
        row.filter_map(|place| place.take_if(|it| it.tick == tick))
            .collect()
    }

    fn switch(&mut self, tick: u64, candidates: &[Candidate], excursion: &Excursion) {
        let due = self.requested.filter(|(from, _)| *from <= tick);
        let channel = due.map(|(_, channel)| channel);
        // Until its channel flies, a request waits. One whose channel flies already is met, whatever the limits then do.
        let is_met = |groups: &GroupSelection| {
            let flown = groups.group_at(tick);
            channel.is_some_and(|it| groups.arrangement.are_alike(it, flown))
        };
        let was_met = is_met(&self.groups);
        let switchover = self.groups.decide(tick, candidates, channel, excursion);
        if let Some(switchover) = switchover {
            self.account.switch(switchover);
        }
        if was_met || is_met(&self.groups) {
            self.requested = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selection::SimplexLimits;
    use messages::role::Role;

    fn message(tick: u64, input_tick: u64, thrust_n: f64) -> Message<RotorSpeeds> {
        let content = RotorSpeeds {
            thrust_n,
            ..RotorSpeeds::default()
        };
        let mut message = Message::of_tick(tick, content);
        message.envelope.input_tick = [input_tick; 3];
        message.envelope.stamps[Role::Mixer as usize].receive_ns = 1;
        message
    }

    /// Two channels with laws of their own.
    fn apart(simplex: Option<SimplexLimits>) -> ChannelSelection {
        let arrangement = Arrangement {
            groups: Channel::ALL,
            simplex,
            ..Arrangement::alike(2)
        };
        ChannelSelection::new(arrangement, 8)
    }

    /// Offers a command of each of two channels, in time: 1 N of channel a, 2 N of channel b.
    fn offer_both(selection: &mut ChannelSelection, tick: u64) {
        selection.offer(Channel::A, &message(tick, tick, 1.0), tick + 1);
        selection.offer(Channel::B, &message(tick, tick, 2.0), tick + 1);
    }

    fn decided(selection: &mut ChannelSelection, tick: u64) -> std::vec::Vec<(u64, f64, u64)> {
        let mut taken = std::vec::Vec::new();
        selection.decide(tick, &Excursion::default(), |it| {
            taken.push((it.tick, it.command.thrust_n, it.effective_tick));
        });
        taken
    }

    #[test]
    fn the_command_of_another_channel_is_taken_where_the_first_has_none_that_is_fresh() {
        let mut selection = ChannelSelection::new(Arrangement::alike(2), 8);
        selection.offer(Channel::B, &message(0, 0, 1.0), 1);
        selection.offer(Channel::A, &message(0, 0, 1.0), 1);
        assert_eq!(decided(&mut selection, 1), [(0, 1.0, 1)]);
        // Stale in channel a, and then nothing from it.
        selection.offer(Channel::A, &message(1, 0, 2.0), 2);
        selection.offer(Channel::B, &message(1, 1, 3.0), 2);
        assert_eq!(decided(&mut selection, 2), [(1, 3.0, 2)]);
        selection.offer(Channel::B, &message(2, 2, 4.0), 3);
        assert_eq!(decided(&mut selection, 3), [(2, 4.0, 3)]);
        // The same command from both is taken once, even if one comes late.
        selection.offer(Channel::A, &message(2, 2, 4.0), 4);
        assert_eq!(decided(&mut selection, 4), []);
        // Nothing of tick 3 came in time: what comes late acts from then on.
        selection.offer(Channel::B, &message(3, 3, 5.0), 5);
        assert_eq!(decided(&mut selection, 5), [(3, 5.0, 5)]);
        let account = selection.redundancy();
        assert_eq!((account.flown, account.masked), ([1, 2, 0], 2));
        assert_eq!((account.not_fresh, account.mismatches), (2, 0));
    }

    #[test]
    fn a_request_waits_for_its_tick_though_the_plant_was_stopped_before_it() {
        let mut selection = apart(None);
        offer_both(&mut selection, 0);
        assert_eq!(decided(&mut selection, 1), [(0, 1.0, 1)]);
        // The plant publishes tick 1, is stopped, and publishes tick 5 next.
        offer_both(&mut selection, 1);
        selection.request(3, Channel::B);
        assert_eq!(decided(&mut selection, 5), [(1, 1.0, 2)]);
        offer_both(&mut selection, 5);
        assert_eq!(decided(&mut selection, 6), [(5, 2.0, 6)]);
        assert_eq!(selection.redundancy().switchovers()[0].tick, 5);
    }

    #[test]
    fn a_request_for_the_channel_that_flies_undoes_no_takeover_of_its_tick() {
        let simplex = SimplexLimits {
            tilt_max_rad: f64::INFINITY,
            rate_max_rad_s: f64::INFINITY,
            error_max_m: f64::INFINITY,
            command_step_max_rad_s: f64::INFINITY,
        };
        let mut selection = apart(Some(simplex));
        offer_both(&mut selection, 0);
        assert_eq!(decided(&mut selection, 1), [(0, 1.0, 1)]);
        // Channel a is silent in the tick for which it is requested.
        selection.request(1, Channel::A);
        selection.offer(Channel::B, &message(1, 1, 2.0), 2);
        assert_eq!(decided(&mut selection, 2), [(1, 2.0, 2)]);
        offer_both(&mut selection, 2);
        assert_eq!(decided(&mut selection, 3), [(2, 2.0, 3)]);
    }

    #[test]
    fn a_plant_that_was_stopped_takes_what_came_meanwhile_in_order() {
        let mut selection = ChannelSelection::new(Arrangement::alike(2), 8);
        for tick in 0..5 {
            selection.offer(Channel::A, &message(tick, tick, tick as f64), tick + 1);
            selection.offer(Channel::B, &message(tick, tick, tick as f64), tick + 1);
        }
        let taken: std::vec::Vec<u64> = decided(&mut selection, 5).iter().map(|it| it.0).collect();
        assert_eq!(taken, [0, 1, 2, 3, 4]);
        assert_eq!(selection.redundancy().unprotected, 0);
    }

    #[test]
    fn a_command_without_a_free_place_is_refused_and_none_is_lost_that_has_one() {
        let mut selection = ChannelSelection::new(Arrangement::alike(3), 8);
        // The plant is stopped for ten ticks after tick 0; one channel after the other is read.
        let mut refused = std::vec::Vec::new();
        for channel in Channel::ALL {
            for tick in 0..10 {
                let message = message(tick, tick, tick as f64);
                refused.extend(selection.offer(channel, &message, tick + 1));
            }
        }
        let refused = refused.iter().map(|it| (it.channel, it.tick));
        let late = Channel::ALL.map(|channel| [(channel, 8), (channel, 9)]);
        assert!(refused.eq(late.into_iter().flatten()));
        let taken = decided(&mut selection, 10);
        assert!(taken.iter().map(|it| it.0).eq(0..8));
    }
}
