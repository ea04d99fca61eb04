//! A hash over everything that the stages put out in a flight: the same bits on every machine, or the laws are not.

use std::fmt;

use crate::role::STAGES;
use crate::topic::Topic;
use crate::vectors::vectorised;

/// The hash so far. Stages may be taken in any order; the outputs of each one in that of their ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutputHash([Outputs; STAGES.len()]);

impl OutputHash {
    /// Takes what a stage put out in a tick; what the recorder says is no stage's output.
    pub fn take<C: Topic>(&mut self, tick: u64, content: &C) {
        if let Some(outputs) = self.0.get_mut(C::SENDER as usize) {
            outputs.take_one(tick);
            outputs.take(content.flight_words());
        }
    }
}

impl fmt::Display for OutputHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut all = Outputs::default();
        self.0
            .iter()
            .for_each(|outputs| all.take_one(outputs.sum()));
        write!(f, "{:016x}", all.sum())
    }
}

/// A stage's outputs so far: the sum of their words, each mixed with its place. No word waits for the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Outputs {
    /// Before the factor that all words have in common.
    unscaled: u64,
    place: u64,
}

/// 2^64 divided by the golden ratio: it gives every place bits of its own.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

impl Outputs {
    #[inline]
    fn take(&mut self, words: &[u64]) {
        self.unscaled = self.unscaled.wrapping_add(unscaled(words, self.place));
        self.place = self
            .place
            .wrapping_add(GOLDEN.wrapping_mul(words.len() as u64));
    }

    #[inline]
    fn take_one(&mut self, word: u64) {
        self.place = self.place.wrapping_add(GOLDEN);
        self.unscaled = self.unscaled.wrapping_add(mixed(word, self.place));
    }

    const fn sum(&self) -> u64 {
        self.unscaled.wrapping_mul(GOLDEN)
    }
}

/// Each step can be undone: where one word differs, so does the sum. The first one brings the upper bits down, which
/// else reach few others: two signs that change would cancel each other every other time.
#[inline(always)]
const fn mixed(word: u64, place: u64) -> u64 {
    const SPREAD: u64 = 0xbf58_476d_1ce4_e5b9;
    let placed = word ^ place;
    let product = (placed ^ (placed >> 32)).wrapping_mul(SPREAD);
    product ^ (product >> 32)
}

vectorised! {
    /// The sum of words that follow a place, each mixed with its own.
    fn unscaled(words: &[u64], before: u64) -> u64 {
        let (mut place, mut sum) = (before, 0_u64);
        for word in words {
            place = place.wrapping_add(GOLDEN);
            sum = sum.wrapping_add(mixed(*word, place));
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use crate::content::{RotorSpeeds, Setpoint, State, Wrench};
    use crate::parameters::Parameter;

    use super::*;

    fn of(change: impl Fn(u64, &mut State, &mut Wrench)) -> String {
        let mut hash = OutputHash::default();
        for tick in 0..3 {
            let (mut state, mut wrench) = (State::default(), Wrench::default());
            change(tick, &mut state, &mut wrench);
            hash.take(tick, &state);
            hash.take(tick, &Setpoint::default());
            hash.take(tick, &wrench);
            hash.take(tick, &RotorSpeeds::default());
        }
        hash.to_string()
    }

    #[test]
    fn one_bit_of_any_stage_in_any_tick_is_another_hash() {
        type Change = fn(u64, &mut State, &mut Wrench);
        let same = of(|_, _, _| ());
        assert_eq!((same.len(), &same), (16, &of(|_, _, _| ())));
        let changes: [Change; 4] = [
            |tick, state, _| state.measured.position_w_m[2] = f64::from_bits(u64::from(tick == 1)),
            |tick, _, wrench| wrench.telemetry.value[1] = if tick == 2 { -0.0 } else { 0.0 },
            |tick, state, _| state.ticks_skipped = tick / 2,
            |tick, state, _| {
                let wind = Parameter::WindY as usize;
                state.truth.parameter[wind] = f64::from_bits(u64::from(tick == 1));
            },
        ];
        for change in changes {
            assert_ne!(of(change), same);
        }
    }

    #[test]
    fn two_words_in_which_the_same_bit_changes_are_another_hash() {
        let of = |changed: &[usize], bit: u32| {
            let mut words = [0_u64; 64];
            changed.iter().for_each(|place| words[*place] ^= 1 << bit);
            let mut outputs = Outputs::default();
            outputs.take(&words);
            outputs.sum()
        };
        for bit in 0..64 {
            for first in 0..64 {
                for second in 0..first {
                    let changed = of(&[first, second], bit);
                    assert_ne!(changed, of(&[], bit), "{bit} of {first} and {second}");
                }
            }
        }
    }

    #[test]
    fn the_order_of_stages_does_not_count_and_that_of_ticks_does() {
        let hash = |ticks: [u64; 2], plant_first: bool| {
            let mut hash = OutputHash::default();
            for is_plant in [plant_first, !plant_first] {
                for tick in ticks {
                    if is_plant {
                        hash.take(tick, &State::default());
                    } else {
                        hash.take(tick, &Wrench::default());
                    }
                }
            }
            hash.to_string()
        };
        assert_eq!(hash([1, 2], true), hash([1, 2], false));
        assert_ne!(hash([1, 2], true), hash([2, 1], true));
    }
}
