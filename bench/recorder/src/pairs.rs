//! Matches every wrench with the state from which it was computed, in whatever order the recorder receives them.
//!
//! The recorder drains topic after topic, so it may receive a wrench before the state that belongs to it.

use std::collections::VecDeque;

use ipc::DEEP;
use messages::content::{NO_TICK, Stamped, State, Wrench};
use messages::header::Message;

use messages::message_window::MessageWindow;

/// States kept without a wrench: twice the number that one drain can return.
const KEPT: usize = 2 * DEEP;

#[derive(Clone, Debug)]
pub struct Pairs {
    states: MessageWindow<State>,
    wrenches: VecDeque<Message<Wrench>>,
}

impl Default for Pairs {
    fn default() -> Self {
        Self {
            states: MessageWindow::keeping(KEPT),
            wrenches: VecDeque::new(),
        }
    }
}

impl Pairs {
    pub fn state(&mut self, message: &Message<State>) {
        self.states.push(*message);
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
        let newest = self.states.newest_tick();
        if state.is_none() && newest.is_none_or(|newest| newest < input_tick) {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs after the states of these ticks, and wrenches of these ticks, each with the tick of its state.
    fn take(
        pairs: &mut Pairs,
        states: impl IntoIterator<Item = u64>,
        wrenches: impl IntoIterator<Item = (u64, u64)>,
    ) {
        for tick in states {
            pairs.state(&Message::of_tick(tick, State::default()));
        }
        for (tick, of_tick) in wrenches {
            let mut wrench = Message::of_tick(tick, Wrench::default());
            wrench.envelope.input_tick = [of_tick, NO_TICK, NO_TICK];
            pairs.wrench(&wrench);
        }
    }

    /// Ticks of the matched wrenches, each with the tick of its state.
    fn paired(pairs: &mut Pairs) -> Vec<(u64, Option<u64>)> {
        let next = std::iter::from_fn(|| pairs.paired());
        next.map(|(wrench, state)| (wrench.envelope.tick, state.map(|state| state.tick)))
            .collect()
    }

    #[test]
    fn a_lost_state_delays_nothing_once_a_later_one_arrives() {
        let mut pairs = Pairs::default();
        take(&mut pairs, [0, 2], (0..4).map(|tick| (tick, tick)));
        assert_eq!(paired(&mut pairs), [(0, Some(0)), (1, None), (2, Some(2))]);
        let (last, state) = pairs.rest().unwrap();
        assert_eq!((last.envelope.tick, state), (3, None));
        assert!(pairs.rest().is_none());
    }

    #[test]
    fn the_number_of_unmatched_states_is_bounded() {
        let mut pairs = Pairs::default();
        let (kept, last) = (KEPT as u64, 5 * KEPT as u64);
        take(
            &mut pairs,
            0..=last,
            [(last, last - kept - 1), (last + 1, last - kept)],
        );
        assert_eq!(
            paired(&mut pairs),
            [(last, None), (last + 1, Some(last - kept))]
        );
    }
}
