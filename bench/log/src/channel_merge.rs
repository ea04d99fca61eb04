//! One stream of messages from several channels: of each tick, those of the channel whose command was taken.
//!
//! The plant records whose command it took for a tick ([`Decision`]). The messages come in the order in which they were
//! sent ([`crate::causal_order`]), so those of a command come before the decision.

use std::collections::BTreeMap;

use messages::content::{Decision, TakenCommand};
use messages::role::{Channel, MOST_CHANNELS, STAGES};
use messages::telemetry::{Signals, Telemetry};
use redundancy::Arrangement;

use crate::entry::LogEntry;

/// Messages of a stage in a tick, by channel.
type OfChannels = [Option<LogEntry>; MOST_CHANNELS];

pub struct ChannelMerge {
    arrangement: Arrangement,
    /// Ticks after which a command can no longer be taken.
    waits_ticks: u64,
    /// Signals of channel a's laws: those that the report, the log and observers know.
    signals: Signals,
    /// Messages that are not decided on, by tick and topic.
    open: BTreeMap<(u64, usize), Box<OfChannels>>,
    next: u64,
    /// The channel whose command was taken last.
    flown: Channel,
}

impl ChannelMerge {
    /// One for a plant in which commands can wait for so many ticks.
    pub const fn new(arrangement: Arrangement, waits_ticks: u64, signals: Signals) -> Self {
        Self {
            arrangement,
            waits_ticks,
            signals,
            open: BTreeMap::new(),
            next: 0,
            flown: Channel::A,
        }
    }

    /// Takes a message, and gives to `each` those of the flight that are decided on now, in their order.
    pub fn take(&mut self, channel: Channel, entry: &LogEntry, mut each: impl FnMut(&LogEntry)) {
        match entry {
            LogEntry::Setpoint(_) | LogEntry::Wrench(_) | LogEntry::RotorSpeeds(_) => {
                let tick = entry.envelope().tick;
                if tick >= self.next {
                    let messages = self.open.entry((tick, entry.topic())).or_default();
                    messages[channel as usize] = Some(*entry);
                }
                return;
            }
            LogEntry::State(message) => {
                let Decision { count, command, .. } = message.content.decision;
                if count == 1 {
                    self.decide(&command, &mut each);
                }
                let tick = message.envelope.tick;
                let waits_ticks = self.waits_ticks;
                self.close(|it| it + waits_ticks <= tick, &mut each);
            }
            LogEntry::Decisions(message) => {
                let commands = message.content.commands().iter();
                commands.for_each(|command| self.decide(command, &mut each));
            }
            LogEntry::Swap(_) | LogEntry::Theorem(_) | LogEntry::Loss(_) => {}
        }
        each(entry);
    }

    /// Closes the ticks up to that of a command that was taken.
    fn decide(&mut self, command: &TakenCommand, each: &mut impl FnMut(&LogEntry)) {
        if command.is_offered == 0 {
            return;
        }
        self.close(|it| it < command.of_tick, each);
        if let Some(channel) = Channel::from_wire(command.channel) {
            self.flown = channel;
        }
        self.close(|it| it == command.of_tick, each);
    }

    /// Gives the messages of the ticks that are still open; no message comes any more.
    pub fn finish(&mut self, mut each: impl FnMut(&LogEntry)) {
        self.close(|_| true, &mut each);
    }

    fn close(&mut self, is_over: impl Fn(u64) -> bool, each: &mut impl FnMut(&LogEntry)) {
        while let Some(open) = self.open.first_entry()
            && is_over(open.key().0)
        {
            let ((tick, topic), messages) = open.remove_entry();
            self.next = tick + 1;
            if let Some(entry) = self.chosen(topic, &messages) {
                each(&entry);
            }
        }
    }

    /// The message of the channel that is flown; if it has none, one of its group that is fresh, or the first.
    fn chosen(&self, topic: usize, messages: &OfChannels) -> Option<LogEntry> {
        let is_own = |it: &Channel| self.arrangement.are_alike(*it, self.flown);
        let of = |channel: Channel| messages[channel as usize];
        let own = Channel::first(self.arrangement.channels).filter(is_own);
        let mut others = own.filter_map(of);
        // The inputs before a topic: state, setpoint and wrench.
        let is_fresh = |entry: &LogEntry| {
            let envelope = entry.envelope();
            let mut inputs = envelope.input_tick[..topic].iter();
            inputs.all(|tick| *tick == envelope.tick)
        };
        let fresh = others.clone().find(is_fresh);
        let mut entry = of(self.flown).or(fresh).or_else(|| others.next())?;
        // Other laws set none of the signals that are known.
        if !is_own(&Channel::A)
            && let Some(telemetry) = entry.telemetry_mut()
        {
            *telemetry = Telemetry::unknown(self.signals.of(STAGES[topic]).len());
        }
        Some(entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::content::{Decisions, State};
    use messages::header::Message;
    use messages::telemetry::Signal;

    /// A message of a tick, which says in its sequence number which channel sent it.
    fn message<C: Default>(tick: u64, channel: Channel) -> Message<C> {
        let mut message = Message::of_tick(tick, C::default());
        (message.envelope.seq, message.envelope.input_tick) = (channel as u64, [tick; 3]);
        message
    }

    fn send(merge: &mut ChannelMerge, ticks: std::ops::Range<u64>, channel: Channel) {
        for tick in ticks {
            for entry in [
                LogEntry::Setpoint(message(tick, channel)),
                LogEntry::Wrench(message(tick, channel)),
                LogEntry::RotorSpeeds(message(tick, channel)),
            ] {
                merge.take(channel, &entry, |_| panic!("not decided on"));
            }
        }
    }

    fn command(tick: u64, channel: Channel) -> TakenCommand {
        TakenCommand {
            of_tick: tick,
            channel: channel as u64,
            is_offered: 1,
            ..TakenCommand::default()
        }
    }

    /// Topic, tick and channel of the flight's messages when the plant sends one.
    fn flown(merge: &mut ChannelMerge, entry: &LogEntry) -> Vec<(usize, u64, u64)> {
        let mut flown = Vec::new();
        merge.take(Channel::A, entry, |entry| {
            let envelope = entry.envelope();
            flown.push((entry.topic(), envelope.tick, envelope.seq));
        });
        assert_eq!(flown.pop().map(|it| it.0), Some(entry.topic()));
        flown
    }

    fn state(tick: u64, taken: Option<TakenCommand>) -> LogEntry {
        let mut message = Message::of_tick(tick, State::default());
        message.content.decision = Decision {
            count: u64::from(taken.is_some()),
            command: taken.unwrap_or_default(),
            refused: 0,
            ..Decision::default()
        };
        LogEntry::State(message)
    }

    #[test]
    fn of_each_tick_there_is_one_message_a_topic_of_the_channel_whose_command_was_taken() {
        use Channel::{A, B};
        let all = |tick, channel| [1, 2, 3].map(|topic| (topic, tick, channel as u64));
        let mut merge = ChannelMerge::new(Arrangement::alike(2), 128, Signals::default());
        send(&mut merge, 1..3, A);
        send(&mut merge, 1..6, B);
        let taken = |tick, channel| state(tick + 1, Some(command(tick, channel)));
        assert_eq!(flown(&mut merge, &taken(1, A)), all(1, A));
        // The plant was stopped, and took no command of tick 3.
        let mut decisions = Decisions {
            count: 3,
            ..Decisions::default()
        };
        decisions.command[..3].copy_from_slice(&[
            command(2, B),
            TakenCommand {
                is_offered: 0,
                ..command(3, A)
            },
            command(4, B),
        ]);
        let decisions = LogEntry::Decisions(Message::of_tick(5, decisions));
        let expected = [all(2, B), all(3, B), all(4, B)].concat();
        assert_eq!(flown(&mut merge, &decisions), expected);
        // A late command is waited for as long as it can be taken.
        assert_eq!(flown(&mut merge, &state(132, None)), []);
        assert_eq!(flown(&mut merge, &state(133, None)), all(5, B));
        send(&mut merge, 5..6, A);
        send(&mut merge, 300..301, A);
        let mut rest = Vec::new();
        merge.finish(|entry| rest.push(entry.envelope().tick));
        assert_eq!(rest, [300; 3]);
    }

    #[test]
    fn signals_of_a_law_that_does_not_fly_are_unknown() {
        const SIGNALS: &[Signal] = &[Signal {
            name: "gain",
            unit: "",
        }];
        let signals = Signals {
            inner: SIGNALS,
            ..Signals::default()
        };
        let mut arrangement = Arrangement::alike(2);
        arrangement.groups[Channel::B as usize] = Channel::B;
        let mut merge = ChannelMerge::new(arrangement, 128, signals);
        send(&mut merge, 1..2, Channel::B);
        let mut shown = Vec::new();
        merge.take(
            Channel::A,
            &state(2, Some(command(1, Channel::B))),
            |entry| {
                if let LogEntry::Wrench(message) = entry {
                    shown.extend_from_slice(&message.content.telemetry.value[..2]);
                }
            },
        );
        assert!(shown[0].is_nan() && shown[1] == 0.0, "{shown:?}");
    }
}
