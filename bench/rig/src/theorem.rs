//! Feeds the theorem's monitor from a flight's messages, through restarts of the inner loop.

use controller::TheoremMonitor;
use messages::content::{Stamped, State, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;

/// One monitor per process of the inner loop.
///
/// Every process starts with initial estimates, and so does its monitor. After a missed message the monitor no longer knows
/// the law's state, and is silent until the next process starts.
#[derive(Clone, Debug)]
pub struct FlightMonitor {
    /// A fresh monitor; none if the law has no theorem.
    begin: Option<TheoremMonitor>,
    epoch: Option<u64>,
    /// Sequence number of the next wrench.
    next_seq: u64,
    /// None after a missed message.
    monitor: Option<TheoremMonitor>,
}

impl FlightMonitor {
    #[must_use]
    pub const fn new(begin: Option<TheoremMonitor>) -> Self {
        Self {
            begin,
            epoch: None,
            next_seq: 0,
            monitor: None,
        }
    }

    #[must_use]
    pub const fn applies(&self) -> bool {
        self.begin.is_some()
    }

    /// The monitor message for a wrench and the state it was computed from; none if a message was missed.
    ///
    /// Its header is that of the wrench.
    pub fn watch(
        &mut self,
        wrench: &Message<Wrench>,
        state: Option<&Stamped<State>>,
    ) -> Option<Message<Monitor>> {
        let envelope = wrench.envelope;
        if self.epoch != Some(envelope.epoch) {
            self.epoch = Some(envelope.epoch);
            self.next_seq = 0;
            self.monitor.clone_from(&self.begin);
        }
        if envelope.seq != self.next_seq || state.is_none() {
            self.monitor = None;
        }
        self.next_seq = envelope.seq.saturating_add(1);
        let content = *self
            .monitor
            .as_mut()?
            .watch(envelope.tick, state?, &wrench.content);
        Some(Message { envelope, content })
    }
}

#[cfg(test)]
mod tests {
    use control_api::Rig;
    use controller::Gains;
    use messages::header::Header;

    use super::*;

    fn wrench(epoch: u64, seq: u64) -> Message<Wrench> {
        let envelope = Header {
            epoch,
            seq,
            tick: 100 * epoch + seq,
            ..Header::new()
        };
        Message {
            envelope,
            content: Wrench::default(),
        }
    }

    /// What is said of a wrench: how many stale ticks there have been, as its state is never of its tick.
    fn said(monitor: &mut FlightMonitor, epoch: u64, seq: u64, has_state: bool) -> Option<u64> {
        let state = Stamped {
            tick: 1,
            content: State::default(),
        };
        let said = monitor.watch(&wrench(epoch, seq), has_state.then_some(&state))?;
        assert_eq!(said.envelope, wrench(epoch, seq).envelope);
        Some(said.content.ticks_stale)
    }

    fn monitor() -> FlightMonitor {
        FlightMonitor::new(Some(TheoremMonitor::new(
            &Rig::default(),
            &Gains::default(),
        )))
    }

    #[test]
    fn every_process_of_the_loop_has_a_monitor_of_its_own() {
        let mut monitor = monitor();
        let counted: Vec<_> = (0..3).map(|seq| said(&mut monitor, 1, seq, true)).collect();
        assert_eq!(counted, [Some(1), Some(2), Some(3)]);
        assert_eq!(said(&mut monitor, 2, 0, true), Some(1));
    }

    #[test]
    fn after_a_lost_message_nothing_is_said_until_the_next_process_begins() {
        let lost: [fn(&mut FlightMonitor) -> Option<u64>; 2] = [
            |monitor| said(monitor, 1, 1, false),
            |monitor| said(monitor, 1, 2, true),
        ];
        for lost in lost {
            let mut monitor = monitor();
            assert_eq!(said(&mut monitor, 1, 0, true), Some(1));
            assert_eq!(lost(&mut monitor), None);
            assert_eq!(said(&mut monitor, 1, 3, true), None);
            assert_eq!(said(&mut monitor, 2, 0, true), Some(1));
        }
    }

    #[test]
    fn of_a_process_that_was_not_seen_from_its_begin_on_nothing_is_said() {
        let mut monitor = monitor();
        assert_eq!(
            [7, 8].map(|seq| said(&mut monitor, 1, seq, true)),
            [None; 2]
        );
    }
}
