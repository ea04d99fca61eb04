//! The states of the stages of all channels after their last messages: a process may have continued from one of them.

use std::collections::{BTreeMap, VecDeque};

use control_api::SavedState;
use messages::channels::Arrangement;
use messages::role::{Channel, Replica};

/// States kept of a stage, with one channel and with several.
const KEPT: [usize; 2] = [2, 64];

pub struct StageStates {
    /// The newest last.
    kept: BTreeMap<Replica, VecDeque<Vec<u8>>>,
    arrangement: Arrangement,
}

impl StageStates {
    pub const fn new(arrangement: Arrangement) -> Self {
        Self {
            kept: BTreeMap::new(),
            arrangement,
        }
    }

    pub fn push(&mut self, stage: Replica, state: &SavedState) {
        let states = self.kept.entry(stage).or_default();
        let is_full = states.len() == KEPT[usize::from(self.arrangement.channels > 1)];
        let mut place = states.pop_front_if(|_| is_full).unwrap_or_default();
        place.clear();
        place.extend_from_slice(state);
        states.push_back(place);
    }

    /// The newest first.
    pub fn of(&self, stage: Replica) -> impl Iterator<Item = &[u8]> {
        let states = self.kept.get(&stage).into_iter().flatten();
        states.rev().map(Vec::as_slice)
    }

    /// The states of the same role in the other channels with the same laws.
    pub fn of_twins(&self, stage: Replica) -> impl Iterator<Item = &[u8]> {
        let is_twin = move |it: &Channel| {
            *it != stage.channel && self.arrangement.are_alike(*it, stage.channel)
        };
        let twins = Channel::first(self.arrangement.channels).filter(is_twin);
        twins.flat_map(move |channel| self.of(Replica::new(stage.role, channel)))
    }
}
