//! History of a law's state: what it goes back to, as a number that the stages of different channels can compare.
//!
//! A stage is *undisturbed* if it has worked every tick since take-off with inputs of that tick from undisturbed senders.
//! All undisturbed stages of a role have the same state after the same tick. The history of such a state is
//! [`UNDISTURBED`]; any other one is a hash over the ticks and the inputs that it goes back to. Two stages whose
//! histories are equal after the same tick have worked the same inputs from the same state, so their outputs are equal.

use crate::content::NO_TICK;
use crate::layout::layout;
use crate::role::Channel;

pub const UNDISTURBED: u64 = 0;

layout! {
    /// The state that a stage's law continued from in a tick, and the history of the state that this tick led to.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct LawState {
        /// Tick after which the law had this state; [`NO_TICK`] is the initial state.
        pub from_tick: u64,
        /// Place among [`crate::role::Channel::ALL`] of the channel that had it.
        pub channel: u64,
        /// Its history.
        pub before: u64,
        /// History of the state after the message's tick.
        pub after: u64,
    }
}

impl LawState {
    pub const INITIAL: Self = Self {
        from_tick: NO_TICK,
        channel: 0,
        before: UNDISTURBED,
        after: UNDISTURBED,
    };

    /// The state that a channel's law had after a tick.
    pub const fn after(tick: u64, channel: Channel, history: u64) -> Self {
        Self {
            from_tick: tick,
            channel: channel as u64,
            before: history,
            after: history,
        }
    }

    /// Whether it is the state that an undisturbed stage has before this tick.
    pub const fn is_undisturbed_before(&self, tick: u64) -> bool {
        self.before == UNDISTURBED
            && match self.from_tick {
                NO_TICK => tick == 0,
                before => before.wrapping_add(1) == tick,
            }
    }

    /// Sets the history after a tick that was worked with these inputs, each with its tick and its history.
    pub fn advance(&mut self, tick: u64, inputs: impl Iterator<Item = (u64, u64)> + Clone) {
        let mut sound = inputs.clone();
        if self.is_undisturbed_before(tick) && sound.all(|it| it == (tick, UNDISTURBED)) {
            self.after = UNDISTURBED;
            return;
        }
        let mut hash = mixed(mixed(mixed(1, self.before), self.from_tick), tick);
        for (tick, history) in inputs {
            hash = mixed(mixed(hash, tick), history);
        }
        self.after = hash.max(1);
    }
}

impl Default for LawState {
    fn default() -> Self {
        Self::INITIAL
    }
}

const fn mixed(hash: u64, word: u64) -> u64 {
    let product = (hash ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    product ^ (product >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(state: LawState, tick: u64, inputs: &[(u64, u64)]) -> u64 {
        let mut state = state;
        state.advance(tick, inputs.iter().copied());
        state.after
    }

    #[test]
    fn a_state_is_undisturbed_if_every_tick_was_worked_with_undisturbed_inputs() {
        let own = |from_tick| LawState {
            from_tick,
            ..LawState::INITIAL
        };
        let sound = [(7, UNDISTURBED); 2];
        assert_eq!(after(own(6), 7, &sound), UNDISTURBED);
        assert_eq!(
            after(LawState::INITIAL, 0, &[(0, UNDISTURBED)]),
            UNDISTURBED
        );
        let stale = [(7, UNDISTURBED), (6, UNDISTURBED)];
        let from_disturbed = [(7, UNDISTURBED), (7, 5)];
        let disturbed = LawState {
            before: 5,
            ..own(6)
        };
        let all = [
            after(LawState::INITIAL, 7, &sound),
            after(own(5), 7, &sound),
            after(own(6), 7, &stale),
            after(own(6), 7, &from_disturbed),
            after(disturbed, 7, &sound),
        ];
        assert!(all.iter().all(|it| *it != UNDISTURBED));
        for (place, history) in all.iter().enumerate() {
            assert!(!all[..place].contains(history), "{place}");
        }
        assert_eq!(after(own(6), 7, &stale), all[2]);
    }
}
