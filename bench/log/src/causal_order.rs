//! Messages of all topics and channels in the order in which they were sent, with a record of those that were lost.
//!
//! The topics are read one after another, so what was read may contain a message without one that it goes back to. What
//! was sent before the reading began is complete: it is released, in the order of the send stamps, and the rest waits for
//! the next reading. No message was sent before one that it goes back to. Every reader of this stream therefore has
//! the inputs of a message before the message, and after a state nothing that was sent before it.

use std::collections::BTreeMap;

use messages::content::{Loss, NO_TICK};
use messages::header::{Header, Message};
use messages::role::Channel;

use crate::entry::LogEntry;

#[derive(Default)]
pub struct CausalOrder {
    waiting: Vec<(Channel, LogEntry)>,
    /// Send time and place of the messages that are released; kept for its memory.
    order: Vec<(u64, usize)>,
    /// The newest message of each topic of each channel.
    newest: BTreeMap<(usize, Channel), Newest>,
    losses: u64,
    newest_tick: u64,
    /// Whether the reader joined the flight: nothing is known of what was sent before the first message of a topic, and the
    /// recorder has numbered the messages, whichever process sent them.
    joins: bool,
}

#[derive(Clone, Copy)]
struct Newest {
    epoch: u64,
    seq: u64,
    tick: u64,
}

impl CausalOrder {
    /// The order of a reader that joins a flight: what was sent before its first messages is not lost.
    pub fn joining() -> Self {
        Self {
            joins: true,
            ..Self::default()
        }
    }

    /// Takes a message as it was read from the topic of its sender.
    pub fn receive(&mut self, channel: Channel, entry: &LogEntry) {
        if let Some(loss) = self.loss(channel, entry) {
            self.take(channel, &loss);
        }
        self.take(channel, entry);
    }

    /// Takes a message whose losses are recorded already.
    pub fn take(&mut self, channel: Channel, entry: &LogEntry) {
        self.waiting.push((channel, *entry));
    }

    /// The record of the messages that were lost before this one, if there are any.
    fn loss(&mut self, channel: Channel, entry: &LogEntry) -> Option<LogEntry> {
        let (topic, envelope) = (entry.topic(), entry.envelope());
        let &Header {
            epoch, seq, tick, ..
        } = envelope;
        let last = self
            .newest
            .insert((topic, channel), Newest { epoch, seq, tick });
        let expected = match last {
            Some(last) if self.joins || last.epoch == epoch => last.seq + 1,
            None if self.joins => seq,
            _ => 0,
        };
        let messages = seq.saturating_sub(expected);
        self.newest_tick = self.newest_tick.max(tick);
        if messages == 0 {
            return None;
        }
        let content = Loss {
            topic: topic as u64,
            channel: channel as u64,
            messages,
            after_tick: last.map_or(NO_TICK, |last| last.tick),
            before_tick: tick,
        };
        let envelope = Header {
            epoch: 0,
            seq: self.losses,
            tick: self.newest_tick,
            ..*envelope
        };
        self.losses += 1;
        Some(LogEntry::Loss(Message { envelope, content }))
    }

    /// Releases the messages that were sent before an instant, at which the reading began [ns].
    pub fn release(&mut self, before_ns: u64, mut each: impl FnMut(Channel, &LogEntry)) {
        let sent = |(place, (_, entry)): (usize, &(Channel, LogEntry))| {
            let sent_ns = entry.envelope().sent_ns();
            (sent_ns < before_ns).then_some((sent_ns, place))
        };
        self.order.clear();
        self.order
            .extend(self.waiting.iter().enumerate().filter_map(sent));
        self.order.sort_unstable();
        for (_, place) in &self.order {
            let (channel, entry) = &self.waiting[*place];
            each(*channel, entry);
        }
        self.waiting
            .retain(|(_, entry)| entry.envelope().sent_ns() >= before_ns);
    }
}

#[cfg(test)]
mod tests {
    use messages::content::RotorSpeeds;
    use messages::role::Role;
    use messages::topic::Topic;

    use super::*;

    fn message<C: Topic>(tick: u64, sent_ns: u64) -> Message<C> {
        let mut message = Message::of_tick(tick, C::default());
        message.envelope.seq = tick;
        message.envelope.stamps[C::SENDER as usize].send_ns = sent_ns;
        message
    }

    fn state(tick: u64, sent_ns: u64) -> LogEntry {
        LogEntry::State(message(tick, sent_ns))
    }

    fn command(tick: u64, sent_ns: u64) -> LogEntry {
        let mut message = message::<RotorSpeeds>(tick, sent_ns);
        message.envelope.stamps[Role::Plant as usize].send_ns = sent_ns - 50;
        LogEntry::RotorSpeeds(message)
    }

    fn released(order: &mut CausalOrder, before_ns: u64) -> Vec<(usize, u64)> {
        let mut released = Vec::new();
        order.release(before_ns, |_, entry| {
            released.push((entry.topic(), entry.envelope().tick));
        });
        released
    }

    #[test]
    fn a_message_comes_after_all_that_it_goes_back_to_however_the_topics_are_read() {
        let mut order = CausalOrder::default();
        // The reading began at 2000. A state and a command were sent during it; only the command was read.
        for entry in [state(0, 0), state(1, 1000)] {
            order.receive(Channel::A, &entry);
        }
        for entry in [command(0, 60), command(1, 1060), command(2, 2060)] {
            order.receive(Channel::A, &entry);
        }
        let expected = [(0, 0), (3, 0), (0, 1), (3, 1)];
        assert_eq!(released(&mut order, 2000), expected);
        order.receive(Channel::A, &state(2, 2000));
        assert_eq!(released(&mut order, 3000), [(0, 2), (3, 2)]);
    }

    #[test]
    fn what_was_lost_is_recorded_before_the_next_message_of_its_topic_and_channel() {
        let mut order = CausalOrder::default();
        order.receive(Channel::A, &command(0, 100));
        order.receive(Channel::B, &command(2, 2100));
        order.receive(Channel::A, &command(4, 4100));
        let mut losses = Vec::new();
        order.release(u64::MAX, |channel, entry| match entry {
            LogEntry::Loss(message) => {
                assert_eq!(message.content.channel, channel as u64);
                losses.push((channel, message.envelope.seq, message.content));
            }
            entry => assert!(entry.topic() == 3),
        });
        let loss = |channel: Channel, messages, after_tick, before_tick| Loss {
            topic: 3,
            channel: channel as u64,
            messages,
            after_tick,
            before_tick,
        };
        let of_a = loss(Channel::A, 3, 0, 4);
        let of_b = loss(Channel::B, 2, NO_TICK, 2);
        assert_eq!(losses, [(Channel::B, 0, of_b), (Channel::A, 1, of_a)]);
    }

    #[test]
    fn an_observer_counts_what_it_was_too_slow_to_read_also_across_a_handover() {
        let mut order = CausalOrder::joining();
        for (seq, epoch) in [(500, 1), (503, 2), (504, 1)] {
            let mut message = message::<RotorSpeeds>(seq, seq);
            message.envelope.epoch = epoch;
            order.receive(Channel::A, &LogEntry::RotorSpeeds(message));
        }
        let mut lost = Vec::new();
        order.release(u64::MAX, |_, entry| {
            if let LogEntry::Loss(message) = entry {
                lost.push((message.content.messages, message.content.before_tick));
            }
        });
        assert_eq!(lost, [(2, 503)]);
    }
}
