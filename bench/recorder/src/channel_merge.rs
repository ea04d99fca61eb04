//! One stream of messages from several channels: of each tick, those of the channel whose command is flown.
//!
//! The rule is the plant's ([`select`]), applied to the stamps of the messages. Messages of other channels with the same
//! content add nothing.

use std::collections::VecDeque;

use flight_log::entry::LogEntry;
use messages::channels::{Arrangement, Candidate, select};
use messages::content::{RotorSpeeds, Setpoint, Wrench};
use messages::grid::Pace;
use messages::header::Message;
use messages::role::{Channel, MOST_CHANNELS, Role};
use messages::telemetry::Telemetry;
use messages::topic::Topic;

/// How many ticks behind the newest state a tick is closed, if a channel has sent no command of it.
const CLOSED_AFTER: u64 = 3;
/// The same while no channel has sent one, of it or of a later tick: it may be late.
const EMPTY_CLOSED_AFTER: u64 = 200;

type OfChannels<C> = [Option<Message<C>>; MOST_CHANNELS];

struct TickMessages {
    tick: u64,
    setpoints: OfChannels<Setpoint>,
    wrenches: OfChannels<Wrench>,
    rotor_speeds: OfChannels<RotorSpeeds>,
}

pub struct ChannelMerge {
    arrangement: Arrangement,
    /// How many ticks behind the newest state a tick is closed at the least.
    behind: u64,
    pace: Pace,
    /// In the order of the ticks.
    open: VecDeque<TickMessages>,
    next: u64,
}

impl ChannelMerge {
    pub fn new(arrangement: Arrangement, pace: Pace) -> Self {
        // Which group flies is known when the next tick has its state.
        let has_groups = arrangement.leaders().count() > 1;
        Self {
            arrangement,
            behind: if has_groups { 2 } else { 0 },
            pace,
            open: VecDeque::new(),
            next: 0,
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

    /// Closes the ticks of which every channel of the group that flew has sent its command, and those far enough behind the newest
    /// state; all of them without one. Gives the messages of each to `each`, of the group that flew by `group_at`.
    pub fn close(
        &mut self,
        newest_state: Option<u64>,
        group_at: impl Fn(u64) -> Channel,
        mut each: impl FnMut(&LogEntry),
    ) {
        while let Some(behind) = self.behind(&group_at)
            && let Some(closed) = self
                .open
                .pop_front_if(|it| newest_state.is_none_or(|newest| it.tick + behind <= newest))
        {
            self.next = closed.tick + 1;
            self.emit(&closed, group_at(closed.tick), &mut each);
        }
    }

    /// How many ticks behind the newest state the first open tick is closed.
    fn behind(&self, group_at: impl Fn(u64) -> Channel) -> Option<u64> {
        let commands = |it: &TickMessages| {
            let own = self.channels_of(group_at(it.tick));
            let sent = own.filter(|channel| it.rotor_speeds[*channel as usize].is_some());
            sent.count()
        };
        let first = self.open.front()?;
        let members = self.channels_of(group_at(first.tick)).count();
        Some(if commands(first) == members {
            self.behind
        } else if self.open.iter().any(|it| commands(it) > 0) {
            CLOSED_AFTER
        } else {
            EMPTY_CLOSED_AFTER
        })
    }

    fn channels_of(&self, group: Channel) -> impl Iterator<Item = Channel> {
        Channel::first(self.arrangement.channels)
            .filter(move |it| self.arrangement.group(*it) == group)
    }

    fn emit(&self, closed: &TickMessages, group: Channel, each: &mut impl FnMut(&LogEntry)) {
        let own: Vec<Channel> = self.channels_of(group).collect();
        let flown = self.flown(closed, &own);
        let entries = [
            first(&closed.setpoints, &own, flown, 1).map(LogEntry::Setpoint),
            first(&closed.wrenches, &own, flown, 2).map(LogEntry::Wrench),
            first(&closed.rotor_speeds, &own, flown, 3).map(LogEntry::RotorSpeeds),
        ];
        for mut entry in entries.into_iter().flatten() {
            // The report, the log and observers know the signals of channel a.
            if group != Channel::A
                && let Some(telemetry) = entry.telemetry_mut()
            {
                *telemetry = Telemetry::default();
            }
            each(&entry);
        }
    }

    /// The channel whose command of a tick is flown, among these.
    fn flown(&self, closed: &TickMessages, own: &[Channel]) -> Channel {
        let candidates: Vec<Candidate> = own
            .iter()
            .filter_map(|channel| {
                let message = closed.rotor_speeds[*channel as usize].as_ref()?;
                let sent_ns = message.envelope.stamps_of(Role::Mixer).send_ns;
                let effective_tick = self.pace.effective_tick(closed.tick, sent_ns);
                Candidate::of(*channel, message, effective_tick)
            })
            .collect();
        select(&candidates).map_or(own[0], |it| it.chosen.channel)
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
    use messages::grid::Grid;
    use messages::header::Header;

    const GRID: Grid = Grid {
        t0_ns: 1_000_000,
        period_ns: 1_000_000,
    };

    /// A message of a tick, which says in its sequence number which channel sent it.
    fn message<C: Default>(tick: u64, channel: Channel, is_fresh: bool) -> Message<C> {
        let mut envelope = Header {
            tick,
            seq: channel as u64,
            input_tick: [if is_fresh { tick } else { 0 }; 3],
            ..Header::new()
        };
        for stamps in &mut envelope.stamps {
            stamps.receive_ns = GRID.begin_of(tick) + 1;
            stamps.send_ns = GRID.begin_of(tick) + 50_000;
        }
        let content = C::default();
        Message { envelope, content }
    }

    fn take(merge: &mut ChannelMerge, tick: u64, channel: Channel, is_fresh: bool) {
        for entry in [
            LogEntry::Setpoint(message(tick, channel, true)),
            LogEntry::Wrench(message(tick, channel, is_fresh)),
            LogEntry::RotorSpeeds(message(tick, channel, is_fresh)),
        ] {
            assert!(merge.take(channel, &entry));
        }
    }

    /// Topic, tick and channel of what is closed.
    fn closed(merge: &mut ChannelMerge, newest: Option<u64>) -> Vec<(usize, u64, u64)> {
        let mut closed = Vec::new();
        merge.close(
            newest,
            |_| Channel::A,
            |entry| {
                let envelope = entry.envelope();
                closed.push((entry.topic(), envelope.tick, envelope.seq));
            },
        );
        closed
    }

    #[test]
    fn of_each_tick_there_is_one_message_a_topic_of_the_channel_that_is_flown() {
        use Channel::{A, B};
        let mut merge = ChannelMerge::new(Arrangement::alike(2), Pace::Realtime(GRID));
        take(&mut merge, 1, A, true);
        assert_eq!(closed(&mut merge, Some(1)), [], "b has not sent yet");
        take(&mut merge, 1, B, true);
        assert_eq!(
            closed(&mut merge, Some(1)),
            [(1, 1, 0), (2, 1, 0), (3, 1, 0)]
        );
        // The inner loop of a was stopped: its wrench is stale, and so is the command.
        take(&mut merge, 2, A, false);
        take(&mut merge, 2, B, true);
        assert_eq!(
            closed(&mut merge, Some(2)),
            [(1, 2, 1), (2, 2, 1), (3, 2, 1)]
        );
        take(&mut merge, 3, B, true);
        assert_eq!(closed(&mut merge, Some(5)), []);
        assert_eq!(
            closed(&mut merge, Some(6)),
            [(1, 3, 1), (2, 3, 1), (3, 3, 1)]
        );
        // A tick without a command, as one that the plant skipped, does not hold up later ones.
        let alone = LogEntry::Setpoint(message(4, A, true));
        assert!(merge.take(A, &alone));
        assert_eq!(closed(&mut merge, Some(8)), []);
        take(&mut merge, 9, A, true);
        take(&mut merge, 9, B, true);
        assert_eq!(
            closed(&mut merge, Some(9)),
            [(1, 4, 0), (1, 9, 0), (2, 9, 0), (3, 9, 0)]
        );
        // Too late to be of use.
        take(&mut merge, 3, A, true);
        take(&mut merge, 10, A, true);
        assert_eq!(
            closed(&mut merge, None),
            [(1, 10, 0), (2, 10, 0), (3, 10, 0)]
        );
    }

    #[test]
    fn a_late_command_of_the_group_that_flies_is_waited_for_whatever_other_groups_send() {
        use Channel::{A, B};
        let arrangement = Arrangement {
            groups: [A, B, B],
            ..Arrangement::alike(2)
        };
        let mut merge = ChannelMerge::new(arrangement, Pace::Realtime(GRID));
        for tick in 1..20 {
            take(&mut merge, tick, B, true);
            assert_eq!(closed(&mut merge, Some(tick)), []);
        }
        take(&mut merge, 1, A, true);
        assert_eq!(
            closed(&mut merge, Some(20)),
            [(1, 1, 0), (2, 1, 0), (3, 1, 0)]
        );
    }
}
