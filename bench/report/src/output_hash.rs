//! A hash over everything that the stages put out in a flight: the same bits on every machine, or the laws are not.

use std::fmt;

use model::layout::{Field, Visitor, Walk, fnv1a};
use model::role::STAGES;
use model::topic::Topic;

/// Before the first byte (FNV-1a).
const BEGIN: u64 = 0xcbf2_9ce4_8422_2325;

/// The hash so far. Stages may be taken in any order; the outputs of each one in that of their ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputHash([u64; STAGES.len()]);

impl Default for OutputHash {
    fn default() -> Self {
        Self([BEGIN; STAGES.len()])
    }
}

impl OutputHash {
    /// Takes what a stage put out in a tick.
    pub fn take<C: Topic>(&mut self, tick: u64, content: &C) {
        let hash = &mut self.0[C::SENDER as usize];
        *hash = fnv1a(*hash, &tick.to_le_bytes());
        content.visit(&mut Hashed(hash));
    }
}

impl fmt::Display for OutputHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = self.0.iter().fold(BEGIN, |all, hash| fnv1a(all, &hash.to_le_bytes()));
        write!(f, "{all:016x}")
    }
}

/// Takes every bit of every field.
struct Hashed<'a>(&'a mut u64);

impl Visitor for Hashed<'_> {
    fn integers(&mut self, _: &'static Field, values: &[u64]) {
        values.iter().for_each(|value| *self.0 = fnv1a(*self.0, &value.to_le_bytes()));
    }

    fn numbers(&mut self, _: &'static Field, values: &[f64]) {
        values.iter().for_each(|value| *self.0 = fnv1a(*self.0, &value.to_le_bytes()));
    }

    fn structs<L: Walk>(&mut self, _: &'static Field, values: &[L]) {
        values.iter().for_each(|value| value.visit(self));
    }
}

#[cfg(test)]
mod tests {
    use model::messages::{RotorSpeeds, Setpoint, State, Wrench};

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
        let same = of(|_, _, _| ());
        assert_eq!((same.len(), &same), (16, &of(|_, _, _| ())));
        assert_ne!(same, of(|tick, state, _| state.position_w_m[2] = if tick == 1 { f64::from_bits(1) } else { 0.0 }));
        assert_ne!(same, of(|tick, _, wrench| wrench.monitor.v_th = if tick == 2 { -0.0 } else { 0.0 }));
        assert_ne!(same, of(|tick, state, _| state.ticks_skipped = tick / 2));
    }

    #[test]
    fn the_order_of_stages_does_not_count_and_that_of_ticks_does() {
        let hash = |ticks: [u64; 2], plant_first: bool| {
            let mut hash = OutputHash::default();
            if plant_first {
                ticks.iter().for_each(|tick| hash.take(*tick, &State::default()));
            }
            ticks.iter().for_each(|tick| hash.take(*tick, &Wrench::default()));
            if !plant_first {
                ticks.iter().for_each(|tick| hash.take(*tick, &State::default()));
            }
            hash.to_string()
        };
        assert_eq!(hash([1, 2], true), hash([1, 2], false));
        assert_ne!(hash([1, 2], true), hash([2, 1], true));
    }
}
