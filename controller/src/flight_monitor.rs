//! Feeds the theorem's monitor from a flight's messages, through restarts of the inner loop.

use crate::TheoremMonitor;
use crate::innovation::Innovation;
use messages::content::{Stamped, State, Wrench};
use messages::header::Message;
use messages::monitor::{Cause, Monitor};

/// One monitor per process of the inner loop; or one for all channels, whose wrenches are the same.
///
/// After a missed message the monitor no longer knows the law's state, and is silent until the next process starts. After
/// a restart, or after another channel took over, it is silent from the first unexplained step: the law may continue
/// from samples that this monitor has not seen.
#[derive(Clone, Debug)]
pub struct FlightMonitor {
    /// A fresh monitor; none if the law has no theorem.
    begin: Option<TheoremMonitor>,
    channels: usize,
    /// Of the process that sent the newest wrench.
    epoch: Option<u64>,
    /// Another process or channel has taken over.
    has_changed: bool,
    /// Sequence number of the next wrench.
    next_seq: u64,
    /// None after a missed message.
    monitor: Option<TheoremMonitor>,
}

impl FlightMonitor {
    pub const fn new(begin: Option<TheoremMonitor>, channels: usize) -> Self {
        Self {
            begin,
            channels,
            epoch: None,
            has_changed: false,
            next_seq: 0,
            monitor: None,
        }
    }

    pub const fn applies(&self) -> bool {
        self.begin.is_some()
    }

    /// Tells one monitor from the next: the epoch of the process that it watches; 0 for all channels.
    pub fn epoch(&self) -> u64 {
        self.epoch.filter(|_| self.channels == 1).unwrap_or(0)
    }

    /// What the steps of the present process show without ground truth.
    pub fn innovation(&self) -> Innovation {
        let monitor = self.monitor.as_ref();
        monitor.map_or(Innovation::default(), |monitor| *monitor.innovation())
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
        self.begin(envelope.epoch);
        // With several channels, what one has lost comes from another.
        if (self.channels == 1 && envelope.seq != self.next_seq) || state.is_none() {
            self.monitor = None;
        }
        self.next_seq = envelope.seq.saturating_add(1);
        let content = *self.watch_next(envelope.tick, state?, &wrench.content)?;
        Some(Message { envelope, content })
    }

    /// The next wrench is of this process.
    pub fn begin(&mut self, epoch: u64) {
        let before = self.epoch.replace(epoch);
        if before != Some(epoch) {
            self.has_changed = before.is_some();
            if !self.has_changed || self.channels == 1 {
                self.next_seq = 0;
                self.monitor.clone_from(&self.begin);
            }
        }
    }

    /// As [`Self::watch`], where no message is lost.
    pub fn watch_next(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        wrench: &Wrench,
    ) -> Option<&Monitor> {
        let shown = self.monitor.as_mut()?.watch(tick, state, wrench);
        if self.has_changed && shown.violations[Cause::Unexplained as usize] > 0 {
            self.monitor = None;
        }
        self.monitor.as_ref().map(TheoremMonitor::shown)
    }
}

#[cfg(test)]
mod tests {
    use crate::Gains;
    use control_api::Rig;

    use super::*;

    fn wrench(epoch: u64, seq: u64) -> Message<Wrench> {
        let mut wrench = Message::of_tick(100 * epoch + seq, Wrench::default());
        (wrench.envelope.epoch, wrench.envelope.seq) = (epoch, seq);
        wrench
    }

    /// The results for wrenches, each with its epoch, its sequence number and whether its state has arrived: how many
    /// stale ticks there have been, as the state is never of the wrench's tick.
    fn results<const N: usize>(wrenches: [(u64, u64, bool); N]) -> [Option<u64>; N] {
        let begin = TheoremMonitor::new(&Rig::default(), &Gains::default());
        let mut monitor = FlightMonitor::new(Some(begin), 1);
        let state = Stamped::new(1, State::default());
        wrenches.map(|(epoch, seq, has_state)| {
            let wrench = wrench(epoch, seq);
            let result = monitor.watch(&wrench, has_state.then_some(&state))?;
            assert_eq!(result.envelope, wrench.envelope);
            Some(result.content.ticks_stale)
        })
    }

    #[test]
    fn every_process_of_the_loop_has_its_own_monitor() {
        let wrenches = [(1, 0, true), (1, 1, true), (1, 2, true), (2, 0, true)];
        assert_eq!(results(wrenches), [Some(1), Some(2), Some(3), Some(1)]);
    }

    #[test]
    fn after_a_lost_message_there_is_no_result_until_the_next_process_begins() {
        for lost in [(1, 1, false), (1, 2, true)] {
            let wrenches = [(1, 0, true), lost, (1, 3, true), (2, 0, true)];
            assert_eq!(results(wrenches), [Some(1), None, None, Some(1)]);
        }
    }

    #[test]
    fn an_unexplained_step_is_not_judged_once_another_process_has_taken_over() {
        for (channels, sender, violations) in
            [(1, 1, Some(1)), (2, 1, Some(1)), (1, 2, None), (2, 2, None)]
        {
            let begin = TheoremMonitor::new(&Rig::default(), &Gains::default());
            let mut monitor = FlightMonitor::new(Some(begin), channels);
            let mut watch = |mut wrench: Message<Wrench>| {
                let tick = wrench.envelope.tick;
                if tick != 100 {
                    wrench.content.telemetry.value.fill(f64::INFINITY);
                }
                let state = Stamped::new(tick, State::default());
                let result = monitor.watch(&wrench, Some(&state))?;
                Some(result.content.violations[Cause::Unexplained as usize])
            };
            assert_eq!(watch(wrench(1, 0)), Some(0));
            let next = wrench(sender, u64::from(sender == 1));
            assert_eq!(
                watch(next),
                violations,
                "sender {sender}, {channels} channels"
            );
        }
    }

    #[test]
    fn a_process_without_its_first_message_has_no_result() {
        assert_eq!(results([(1, 7, true), (1, 8, true)]), [None; 2]);
    }
}
