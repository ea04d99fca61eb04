//! Which channel's command of a tick is taken: decided when the next tick begins, with what has come by then.
//!
//! There is no timeout and no failure detector: a chain needs a small part of a tick, and every command has until the next
//! tick begins. The rules are those of [`GroupSelection`].

use heapless::Vec;
use messages::channels::{
    Arrangement, Candidate, Excursion, GroupSelection, Redundancy, RedundancyAccount,
};
use messages::content::{RotorSpeeds, Stamped};
use messages::header::Message;
use messages::role::{Channel, MOST_CHANNELS};

use crate::command_hold::PENDING_COMMANDS;

#[derive(Clone, Debug)]
pub struct ChannelSelection {
    waiting: Vec<Candidate, { MOST_CHANNELS * PENDING_COMMANDS }>,
    /// The tick whose state was published last, and whose commands are decided on next.
    published: u64,
    /// The first tick whose command has not been taken: a command that comes late may still be needed.
    untaken: u64,
    groups: GroupSelection,
    /// The channel that was requested to fly, and the first tick whose command is to be its.
    requested: Option<(u64, Channel)>,
    /// The commands of the last tick.
    last: Vec<Candidate, MOST_CHANNELS>,
    account: RedundancyAccount,
}

impl ChannelSelection {
    pub fn new(arrangement: Arrangement) -> Self {
        Self {
            groups: GroupSelection::new(arrangement),
            requested: None,
            last: Vec::new(),
            waiting: Vec::new(),
            published: 0,
            untaken: 0,
            account: RedundancyAccount::new(arrangement),
        }
    }

    pub const fn redundancy(&self) -> &Redundancy {
        &self.account.redundancy
    }

    /// Whether a channel's laws can fly: a channel with them had a fresh command of the last tick on time.
    pub fn is_ready(&self, channel: Channel) -> bool {
        self.groups.is_ready(channel, &self.last)
    }

    /// Requests that the command of a tick, and those after it, are of this channel's laws.
    pub const fn request(&mut self, from: u64, channel: Channel) {
        self.requested = Some((from, channel));
    }

    /// Takes a channel's command, which may act from `effective_tick` on. Without room the oldest one is dropped.
    pub fn offer(&mut self, channel: Channel, message: &Message<RotorSpeeds>, effective_tick: u64) {
        if let Some(candidate) = Candidate::of(channel, message, effective_tick) {
            if self.waiting.is_full() {
                self.waiting.remove(0);
            }
            let _ = self.waiting.push(candidate);
        }
    }

    /// Decides on the commands of all ticks before `tick`, which begins now, and gives those that are taken to `take`, each
    /// with the tick from which on it may act. Nothing is counted for ticks without a state, of which the last one has
    /// `excursion`.
    pub fn decide(
        &mut self,
        tick: u64,
        excursion: &Excursion,
        mut take: impl FnMut(&Stamped<RotorSpeeds>, u64),
    ) {
        let mut published = (self.published < tick).then_some(self.published);
        self.published = tick;
        while let Some(made_for) = self.first_undecided(published).filter(|it| *it < tick) {
            let mut candidates: Vec<Candidate, MOST_CHANNELS> = Vec::new();
            for channel in Channel::ALL {
                let is_it = |it: &&Candidate| (it.tick, it.channel) == (made_for, channel);
                candidates.extend(self.waiting.iter().find(is_it).copied());
            }
            self.waiting.retain(|it| it.tick != made_for);
            let is_published = published.take_if(|it| *it == made_for).is_some();
            if is_published {
                let due = self.requested.filter(|(from, _)| *from <= made_for);
                let channel = due.map(|(_, channel)| channel);
                let switchover = self
                    .groups
                    .decide(made_for, &candidates, channel, excursion);
                if let Some(switchover) = switchover {
                    self.account.switch(switchover);
                }
                let is_flown = |it: Channel| {
                    let arrangement = &self.groups.arrangement;
                    arrangement.are_alike(it, self.groups.group_at(made_for))
                };
                // Until the channel is ready, the request waits.
                if channel.is_some_and(is_flown) {
                    self.requested = None;
                }
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
                let chosen = &selection.chosen;
                take(
                    &Stamped::new(made_for, chosen.command),
                    chosen.effective_tick,
                );
                self.account.take(made_for, chosen.channel);
                self.untaken = made_for + 1;
            }
        }
    }

    fn first_undecided(&self, published: Option<u64>) -> Option<u64> {
        let waiting = self.waiting.iter().map(|it| it.tick);
        waiting.chain(published).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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

    fn decided(selection: &mut ChannelSelection, tick: u64) -> std::vec::Vec<(u64, f64, u64)> {
        let mut taken = std::vec::Vec::new();
        selection.decide(tick, &Excursion::default(), |command, effective_tick| {
            taken.push((command.tick, command.content.thrust_n, effective_tick));
        });
        taken
    }

    #[test]
    fn the_command_of_another_channel_is_taken_where_the_first_has_none_that_is_fresh() {
        let mut selection = ChannelSelection::new(Arrangement::alike(2));
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
        let mut selection = ChannelSelection::new(Arrangement {
            groups: Channel::ALL,
            ..Arrangement::alike(2)
        });
        let offer = |selection: &mut ChannelSelection, tick| {
            selection.offer(Channel::A, &message(tick, tick, 1.0), tick + 1);
            selection.offer(Channel::B, &message(tick, tick, 2.0), tick + 1);
        };
        offer(&mut selection, 0);
        assert_eq!(decided(&mut selection, 1), [(0, 1.0, 1)]);
        // The plant publishes tick 1, is stopped, and publishes tick 5 next.
        offer(&mut selection, 1);
        selection.request(3, Channel::B);
        assert_eq!(decided(&mut selection, 5), [(1, 1.0, 2)]);
        offer(&mut selection, 5);
        assert_eq!(decided(&mut selection, 6), [(5, 2.0, 6)]);
        assert_eq!(selection.redundancy().switchovers()[0].tick, 5);
    }

    #[test]
    fn a_plant_that_was_stopped_takes_what_came_meanwhile_in_order() {
        let mut selection = ChannelSelection::new(Arrangement::alike(2));
        for tick in 0..5 {
            selection.offer(Channel::A, &message(tick, tick, tick as f64), tick + 1);
            selection.offer(Channel::B, &message(tick, tick, tick as f64), tick + 1);
        }
        let taken: std::vec::Vec<u64> = decided(&mut selection, 5).iter().map(|it| it.0).collect();
        assert_eq!(taken, [0, 1, 2, 3, 4]);
        assert_eq!(selection.redundancy().unprotected, 0);
    }
}
