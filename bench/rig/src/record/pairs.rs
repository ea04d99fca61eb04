//! Puts every wrench beside the state that it was made from, however the recorder gets them.
//!
//! The recorder takes topic after topic, so a state that came while it did so is taken after the wrench made from it.

use std::collections::VecDeque;

use model::envelope::Message;
use model::messages::{Dated, NO_TICK, State, Wrench};
use wire::DEEP;

use crate::window::Window;

/// States kept where no wrench asks for them: as many as are taken at once, twice. A wrench is made from the newest.
const KEPT: usize = 2 * DEEP;

/// States and wrenches that are not paired yet.
#[derive(Clone, Debug)]
pub struct Pairs {
    states: Window<State>,
    wrenches: VecDeque<Message<Wrench>>,
}

impl Pairs {
    /// Nothing so far.
    #[must_use]
    pub const fn new() -> Self {
        Self { states: Window::keeping(KEPT), wrenches: VecDeque::new() }
    }

    /// Takes the next state.
    pub fn state(&mut self, message: &Message<State>) {
        self.states.extend(std::slice::from_ref(message));
        self.states.advance();
    }

    /// Takes the next wrench.
    pub fn wrench(&mut self, message: &Message<Wrench>) {
        self.wrenches.push_back(*message);
    }

    /// The next wrench, with its state; without one where it was lost. None where the state may still come.
    pub fn paired(&mut self) -> Option<(Message<Wrench>, Option<Dated<State>>)> {
        let input_tick = self.wrenches.front()?.envelope.input_tick[0];
        let state = self.states.input(input_tick);
        // States come in order: what is older than the newest comes no more.
        if state.is_none() && self.states.newest_tick().is_none_or(|newest| newest < input_tick) {
            return None;
        }
        // No later wrench is made from an older one.
        if input_tick != NO_TICK {
            self.states.forget_before(input_tick);
        }
        self.wrenches.pop_front().map(|wrench| (wrench, state))
    }

    /// As [`Self::paired`], when no state comes any more.
    pub fn rest(&mut self) -> Option<(Message<Wrench>, Option<Dated<State>>)> {
        self.paired().or_else(|| self.wrenches.pop_front().map(|wrench| (wrench, None)))
    }
}

impl Default for Pairs {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use model::envelope::Envelope;

    use super::*;

    fn state(pairs: &mut Pairs, tick: u64) {
        let mut message = Message::<State>::default();
        (message.envelope.tick, message.content.ticks_skipped) = (tick, tick);
        pairs.state(&message);
    }

    fn wrench(pairs: &mut Pairs, tick: u64, of_tick: u64) {
        let envelope = Envelope { tick, input_tick: [of_tick, NO_TICK, NO_TICK], ..Envelope::new() };
        pairs.wrench(&Message { envelope, content: Wrench::default() });
    }

    /// Ticks of the wrenches that are paired, each with that of its state.
    fn paired(pairs: &mut Pairs) -> Vec<(u64, Option<u64>)> {
        let ticks = |(wrench, state): (Message<Wrench>, Option<Dated<State>>)| {
            let of = state.map(|state| state.tick);
            assert!(of.is_none_or(|tick| tick == NO_TICK || tick == state.unwrap().content.ticks_skipped));
            (wrench.envelope.tick, of)
        };
        std::iter::from_fn(|| pairs.paired()).map(ticks).collect()
    }

    #[test]
    fn a_wrench_waits_for_a_state_that_is_taken_after_it() {
        let mut pairs = Pairs::new();
        state(&mut pairs, 0);
        (0..3).for_each(|tick| wrench(&mut pairs, tick, tick));
        assert_eq!(paired(&mut pairs), [(0, Some(0))]);
        (1..9).for_each(|tick| state(&mut pairs, tick));
        assert_eq!(paired(&mut pairs), [(1, Some(1)), (2, Some(2))]);
    }

    #[test]
    fn a_stale_state_is_found_again_and_one_that_never_was_is_none() {
        let mut pairs = Pairs::new();
        wrench(&mut pairs, 0, NO_TICK);
        (1..4).for_each(|tick| wrench(&mut pairs, tick, 1));
        [0, 1].into_iter().for_each(|tick| state(&mut pairs, tick));
        assert_eq!(paired(&mut pairs), [(0, Some(NO_TICK)), (1, Some(1)), (2, Some(1)), (3, Some(1))]);
    }

    #[test]
    fn a_lost_state_holds_nothing_up_once_a_later_one_is_there_or_nothing_more_comes() {
        let mut pairs = Pairs::new();
        (0..4).for_each(|tick| wrench(&mut pairs, tick, tick));
        [0, 2].into_iter().for_each(|tick| state(&mut pairs, tick));
        assert_eq!(paired(&mut pairs), [(0, Some(0)), (1, None), (2, Some(2))]);
        let (last, state) = pairs.rest().unwrap();
        assert_eq!((last.envelope.tick, state, pairs.rest().is_none()), (3, None, true));
    }

    #[test]
    fn what_waits_for_a_loop_that_is_not_there_is_bounded() {
        let mut pairs = Pairs::new();
        let (kept, last) = (KEPT as u64, 5 * KEPT as u64);
        (0..=last).for_each(|tick| state(&mut pairs, tick));
        wrench(&mut pairs, last, last - kept - 1);
        wrench(&mut pairs, last + 1, last - kept);
        assert_eq!(paired(&mut pairs), [(last, None), (last + 1, Some(last - kept))]);
    }
}
