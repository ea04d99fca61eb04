//! Matches every wrench with the state from which it was computed, in whatever order the recorder receives them.
//!
//! The recorder drains topic after topic, so it may receive a wrench before the state that belongs to it.

use std::collections::VecDeque;

use ipc::DEEP;
use messages::content::{NO_TICK, Stamped, State, Wrench};
use messages::header::Message;

use crate::message_window::MessageWindow;

/// States kept without a wrench: twice the number that one drain can return.
const KEPT: usize = 2 * DEEP;

#[derive(Clone, Debug)]
pub struct Pairs {
    states: MessageWindow<State>,
    wrenches: VecDeque<Message<Wrench>>,
}

impl Pairs {
    #[must_use]
    pub const fn new() -> Self {
        Self {
            states: MessageWindow::keeping(KEPT),
            wrenches: VecDeque::new(),
        }
    }

    pub fn state(&mut self, message: &Message<State>) {
        self.states.extend(std::slice::from_ref(message));
        self.states.advance();
    }

    pub fn wrench(&mut self, message: &Message<Wrench>) {
        self.wrenches.push_back(*message);
    }

    /// The next wrench with its state, or without if that state was lost. None while the state may still arrive.
    pub fn paired(&mut self) -> Option<(Message<Wrench>, Option<Stamped<State>>)> {
        let input_tick = self.wrenches.front()?.envelope.input_tick[0];
        let state = self.states.input(input_tick);
        // States arrive in order: one older than the newest no longer arrives.
        if state.is_none()
            && self
                .states
                .newest_tick()
                .is_none_or(|newest| newest < input_tick)
        {
            return None;
        }
        // Later wrenches are not computed from older states.
        if input_tick != NO_TICK {
            self.states.forget_before(input_tick);
        }
        self.wrenches.pop_front().map(|wrench| (wrench, state))
    }

    /// Like [`Self::paired`] when no more states arrive.
    pub fn rest(&mut self) -> Option<(Message<Wrench>, Option<Stamped<State>>)> {
        self.paired()
            .or_else(|| self.wrenches.pop_front().map(|wrench| (wrench, None)))
    }
}

impl Default for Pairs {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use messages::header::Header;

    use super::*;

    fn state(pairs: &mut Pairs, tick: u64) {
        let mut message = Message::<State>::default();
        (message.envelope.tick, message.content.ticks_skipped) = (tick, tick);
        pairs.state(&message);
    }

    fn wrench(pairs: &mut Pairs, tick: u64, of_tick: u64) {
        let envelope = Header {
            tick,
            input_tick: [of_tick, NO_TICK, NO_TICK],
            ..Header::new()
        };
        pairs.wrench(&Message {
            envelope,
            content: Wrench::default(),
        });
    }

    /// Ticks of the matched wrenches, each with the tick of its state.
    fn paired(pairs: &mut Pairs) -> Vec<(u64, Option<u64>)> {
        let ticks =
            |(wrench, state): (Message<Wrench>, Option<Stamped<State>>)| {
                let of = state.map(|state| state.tick);
                assert!(of.is_none_or(
                    |tick| tick == NO_TICK || tick == state.unwrap().content.ticks_skipped
                ));
                (wrench.envelope.tick, of)
            };
        std::iter::from_fn(|| pairs.paired()).map(ticks).collect()
    }

    #[test]
    fn a_wrench_waits_for_a_state_received_after_it() {
        let mut pairs = Pairs::new();
        state(&mut pairs, 0);
        (0..3).for_each(|tick| wrench(&mut pairs, tick, tick));
        assert_eq!(paired(&mut pairs), [(0, Some(0))]);
        (1..9).for_each(|tick| state(&mut pairs, tick));
        assert_eq!(paired(&mut pairs), [(1, Some(1)), (2, Some(2))]);
    }

    #[test]
    fn a_stale_state_is_used_again_and_a_missing_one_is_none() {
        let mut pairs = Pairs::new();
        wrench(&mut pairs, 0, NO_TICK);
        (1..4).for_each(|tick| wrench(&mut pairs, tick, 1));
        [0, 1].into_iter().for_each(|tick| state(&mut pairs, tick));
        assert_eq!(
            paired(&mut pairs),
            [(0, Some(NO_TICK)), (1, Some(1)), (2, Some(1)), (3, Some(1))]
        );
    }

    #[test]
    fn a_lost_state_delays_nothing_once_a_later_one_arrives() {
        let mut pairs = Pairs::new();
        (0..4).for_each(|tick| wrench(&mut pairs, tick, tick));
        [0, 2].into_iter().for_each(|tick| state(&mut pairs, tick));
        assert_eq!(paired(&mut pairs), [(0, Some(0)), (1, None), (2, Some(2))]);
        let (last, state) = pairs.rest().unwrap();
        assert_eq!(
            (last.envelope.tick, state, pairs.rest().is_none()),
            (3, None, true)
        );
    }

    #[test]
    fn the_number_of_unmatched_states_is_bounded() {
        let mut pairs = Pairs::new();
        let (kept, last) = (KEPT as u64, 5 * KEPT as u64);
        (0..=last).for_each(|tick| state(&mut pairs, tick));
        wrench(&mut pairs, last, last - kept - 1);
        wrench(&mut pairs, last + 1, last - kept);
        assert_eq!(
            paired(&mut pairs),
            [(last, None), (last + 1, Some(last - kept))]
        );
    }
}
