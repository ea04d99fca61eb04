//! One stream of messages from several channels: of each tick, those of the channel whose command is flown.
//!
//! The plant says whose command it took ([`Redundancy::taken`]).

use std::collections::VecDeque;

use flight_log::entry::LogEntry;
use messages::channels::{Arrangement, Redundancy};
use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::header::Message;
use messages::role::{Channel, MOST_CHANNELS};
use messages::telemetry::Telemetry;
use messages::topic::Topic;

/// How many ticks behind the newest state a tick is closed, if the plant has taken no command of it or of a later tick: it
/// may be late.
const CLOSED_AFTER: u64 = 200;

type OfChannels<C> = [Option<Message<C>>; MOST_CHANNELS];

struct TickMessages {
    tick: u64,
    setpoints: OfChannels<Setpoint>,
    wrenches: OfChannels<Wrench>,
    rotor_speeds: OfChannels<RotorSpeeds>,
}

pub struct ChannelMerge {
    arrangement: Arrangement,
    /// In the order of the ticks.
    open: VecDeque<TickMessages>,
    next: u64,
    /// The channel whose command was taken last.
    flown: Channel,
}

impl ChannelMerge {
    pub const fn new(arrangement: Arrangement) -> Self {
        Self {
            arrangement,
            open: VecDeque::new(),
            next: 0,
            flown: Channel::A,
        }
    }

    /// Takes a message of a channel; false if it is none that channels send. Of a closed tick it is left out.
    pub fn take(&mut self, channel: Channel, entry: &LogEntry) -> bool {
        let place = channel as usize;
        match entry {
            LogEntry::Setpoint(message) => {
                self.slot(message, |tick| tick.setpoints[place] = Some(*message));
            }
            LogEntry::Wrench(message) => {
                self.slot(message, |tick| tick.wrenches[place] = Some(*message));
            }
            LogEntry::RotorSpeeds(message) => {
                self.slot(message, |tick| tick.rotor_speeds[place] = Some(*message));
            }
            LogEntry::State(_) | LogEntry::Swap(_) | LogEntry::Theorem(_) => return false,
        }
        true
    }

    fn slot<C: Topic>(&mut self, message: &Message<C>, put: impl FnOnce(&mut TickMessages)) {
        let tick = message.envelope.tick;
        if tick < self.next {
            return;
        }
        let place = self.open.partition_point(|open| open.tick < tick);
        if self.open.get(place).is_none_or(|open| open.tick != tick) {
            let empty = TickMessages {
                tick,
                setpoints: [None; MOST_CHANNELS],
                wrenches: [None; MOST_CHANNELS],
                rotor_speeds: [None; MOST_CHANNELS],
            };
            self.open.insert(place, empty);
        }
        put(&mut self.open[place]);
    }

    /// Closes the ticks that the plant has decided on, and those far enough behind the newest state; all of them without one.
    /// Gives the messages of each to `each`.
    pub fn close(
        &mut self,
        newest_state: Option<u64>,
        account: &Redundancy,
        mut each: impl FnMut(&LogEntry),
    ) {
        let is_over = |it: &mut TickMessages| {
            it.tick < account.taken_end
                || newest_state.is_none_or(|newest| it.tick + CLOSED_AFTER <= newest)
        };
        while let Some(closed) = self.open.pop_front_if(is_over) {
            self.next = closed.tick + 1;
            self.flown = account.taken(closed.tick).unwrap_or(self.flown);
            self.emit(&closed, &mut each);
        }
    }

    fn emit(&self, closed: &TickMessages, each: &mut impl FnMut(&LogEntry)) {
        let is_own = |it: &Channel| self.arrangement.are_alike(*it, self.flown);
        let own: Vec<Channel> = Channel::first(self.arrangement.channels)
            .filter(is_own)
            .collect();
        let entries = [
            first(&closed.setpoints, &own, self.flown, 1).map(LogEntry::Setpoint),
            first(&closed.wrenches, &own, self.flown, 2).map(LogEntry::Wrench),
            first(&closed.rotor_speeds, &own, self.flown, 3).map(LogEntry::RotorSpeeds),
        ];
        for mut entry in entries.into_iter().flatten() {
            // The report, the log and observers know the signals of channel a.
            if !is_own(&Channel::A)
                && let Some(telemetry) = entry.telemetry_mut()
            {
                *telemetry = Telemetry::default();
            }
            each(&entry);
        }
    }
}

/// Whether the first so many inputs, of state, setpoint and wrench, are of the message's tick.
fn is_fresh<C>(message: &Message<C>, inputs: usize) -> bool {
    let envelope = &message.envelope;
    envelope.input_tick[..inputs]
        .iter()
        .all(|tick| *tick == envelope.tick)
}

/// The message of the channel that is flown; if it has none, one of its group that is fresh, or the first.
fn first<C: Copy>(
    messages: &OfChannels<C>,
    own: &[Channel],
    flown: Channel,
    inputs: usize,
) -> Option<Message<C>> {
    let of = |channel: Channel| messages[channel as usize];
    let mut others = own.iter().filter_map(|channel| of(*channel));
    let fresh = others.clone().find(|message| is_fresh(message, inputs));
    of(flown).or(fresh).or_else(|| others.next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::channels::RedundancyAccount;

    /// A message of a tick, which says in its sequence number which channel sent it.
    fn message<C: Default>(tick: u64, channel: Channel) -> Message<C> {
        let mut message = Message::of_tick(tick, C::default());
        (message.envelope.seq, message.envelope.input_tick) = (channel as u64, [tick; 3]);
        message
    }

    fn take(merge: &mut ChannelMerge, ticks: std::ops::Range<u64>, channel: Channel) {
        for tick in ticks {
            for entry in [
                LogEntry::Setpoint(message(tick, channel)),
                LogEntry::Wrench(message(tick, channel)),
                LogEntry::RotorSpeeds(message(tick, channel)),
            ] {
                assert!(merge.take(channel, &entry));
            }
        }
    }

    /// Topic, tick and channel of what is closed.
    fn closed(
        merge: &mut ChannelMerge,
        newest: Option<u64>,
        account: &Redundancy,
    ) -> Vec<(usize, u64, u64)> {
        let mut closed = Vec::new();
        merge.close(newest, account, |entry| {
            let envelope = entry.envelope();
            closed.push((entry.topic(), envelope.tick, envelope.seq));
        });
        closed
    }

    #[test]
    fn of_each_tick_there_is_one_message_a_topic_of_the_channel_whose_command_was_taken() {
        use Channel::{A, B};
        let all = |tick, channel| [1, 2, 3].map(|topic| (topic, tick, channel as u64));
        let mut merge = ChannelMerge::new(Arrangement::alike(2));
        let mut account = RedundancyAccount::new(Arrangement::alike(2));
        take(&mut merge, 1..3, A);
        take(&mut merge, 1..5, B);
        assert_eq!(closed(&mut merge, Some(2), &account.redundancy), []);
        account.take(1, A);
        account.take(2, B);
        let expected = [all(1, A), all(2, B)].concat();
        assert_eq!(closed(&mut merge, Some(2), &account.redundancy), expected);
        // The plant took no command of tick 3, but a later one.
        account.take(4, B);
        let expected = [all(3, B), all(4, B)].concat();
        assert_eq!(closed(&mut merge, Some(4), &account.redundancy), expected);
        // A late command is waited for, but not for ever.
        take(&mut merge, 5..6, B);
        take(&mut merge, 3..5, A);
        let newest = 5 + CLOSED_AFTER;
        assert_eq!(
            closed(&mut merge, Some(newest - 1), &account.redundancy),
            []
        );
        assert_eq!(
            closed(&mut merge, Some(newest), &account.redundancy),
            all(5, B)
        );
        take(&mut merge, 300..301, A);
        assert_eq!(closed(&mut merge, None, &account.redundancy), all(300, A));
    }
}
