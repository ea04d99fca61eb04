//! Chooses what a log of excerpts keeps: the ticks around missed deadlines, swaps, take-off and landing.
//!
//! ```text
//!   tick      0 .. around          e - around .. e .. e + around           last - around .. last
//!             |-- take-off --|     |-------- missed or swapped ------|     |---- landing ------|
//!                             left out                                left out
//! ```
//!
//! Messages wait in a ring until it is known whether an event wants them, `around` ticks long. Every swap is kept.

use crate::entry::{Counts, LogEntry};
use messages::content::State;
use messages::header::Message;
use std::collections::VecDeque;
use std::ops::RangeInclusive;

/// How far a topic may come behind the states [ticks]: more than the recorder takes in at once.
const BEHIND_TICKS: u64 = 20_000;

#[derive(Clone, Debug, Default)]
pub struct EventLog {
    around_ticks: u64,
    /// What an event that is still to come may want, as it came.
    waiting: VecDeque<LogEntry>,
    /// Ticks that are kept, in order and apart from each other.
    kept: VecDeque<RangeInclusive<u64>>,
    newest: Option<Seen>,
    /// How many stretches are kept, apart from each other.
    pub stretches: u64,
    /// Messages that no event wanted; those that wait are not among them.
    pub left_out: Counts,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    tick: u64,
    missed: u64,
    parameter_epoch: u64,
}

impl EventLog {
    pub fn new(around_ticks: u64) -> Self {
        Self {
            around_ticks,
            ..Self::default()
        }
    }

    pub fn take(&mut self, entry: LogEntry, mut keep: impl FnMut(&LogEntry)) {
        if let LogEntry::State(state) = &entry {
            if let Some(event) = self.event(state) {
                self.widen(event, &mut keep);
            }
            self.forget(state.envelope.tick);
        }
        if matches!(entry, LogEntry::Swap(_)) || is_in(&self.kept, entry.envelope().tick) {
            keep(&entry);
        } else {
            self.waiting.push_back(entry);
        }
    }

    /// Hands on what belongs to the landing: nothing more comes.
    pub fn finish(&mut self, mut keep: impl FnMut(&LogEntry)) {
        if let Some(Seen { tick, .. }) = self.newest {
            self.widen(tick..=tick, &mut keep);
        }
        self.waiting
            .drain(..)
            .for_each(|entry| self.left_out[entry.topic()] += 1);
    }

    /// The ticks of an event that a state tells of.
    fn event(&mut self, state: &Message<State>) -> Option<RangeInclusive<u64>> {
        let tick = state.envelope.tick;
        let State {
            deadlines_missed: missed,
            parameter_epoch,
            ..
        } = state.content;
        let before = self.newest.replace(Seen {
            tick,
            missed,
            parameter_epoch,
        });
        match before {
            None => Some(tick..=tick),
            // Of the ticks since the last state, any may have missed.
            Some(before) if missed > before.missed => Some(before.tick + 1..=tick),
            Some(before) if parameter_epoch != before.parameter_epoch => Some(tick..=tick),
            Some(_) => None,
        }
    }

    fn widen(&mut self, event: RangeInclusive<u64>, keep: &mut impl FnMut(&LogEntry)) {
        let (from, to) = (
            event.start().saturating_sub(self.around_ticks),
            event.end() + self.around_ticks,
        );
        match self.kept.back_mut() {
            Some(last) if from <= last.end() + 1 => *last = *last.start()..=to,
            _ => {
                self.stretches += 1;
                self.kept.push_back(from..=to);
            }
        }
        let kept = &self.kept;
        self.waiting.retain(|entry| {
            let is_kept = is_in(kept, entry.envelope().tick);
            if is_kept {
                keep(entry);
            }
            !is_kept
        });
    }

    /// Lets go what no event after this tick can want.
    fn forget(&mut self, tick: u64) {
        let oldest = tick.saturating_sub(self.around_ticks);
        while let Some(entry) = self
            .waiting
            .pop_front_if(|entry| entry.envelope().tick < oldest)
        {
            self.left_out[entry.topic()] += 1;
        }
        while self
            .kept
            .pop_front_if(|range| range.end() + BEHIND_TICKS < tick)
            .is_some()
        {}
    }
}

fn is_in(kept: &VecDeque<RangeInclusive<u64>>, tick: u64) -> bool {
    kept.iter()
        .rev()
        .take_while(|range| *range.end() >= tick)
        .any(|range| range.contains(&tick))
}

#[cfg(test)]
mod tests {
    use messages::content::{SwapRecord, Wrench};

    use super::*;

    fn state(tick: u64, deadlines_missed: u64, parameter_epoch: u64) -> LogEntry {
        let mut message = Message::of_tick(tick, State::default());
        message.content.deadlines_missed = deadlines_missed;
        message.content.parameter_epoch = parameter_epoch;
        LogEntry::State(message)
    }

    fn wrench(tick: u64) -> LogEntry {
        LogEntry::Wrench(Message::of_tick(tick, Wrench::default()))
    }

    #[test]
    fn kept_is_what_is_around_take_off_misses_swaps_and_landing_however_it_is_drained() {
        let ticks: Vec<u64> = (0..=500).collect();
        for batch in [1, 10, 100, 1000] {
            let mut excerpt = EventLog::new(10);
            // Of the states and of the wrenches.
            let mut kept = [Vec::new(), Vec::new()];
            let mut keep = |entry: &LogEntry| kept[entry.topic() / 2].push(entry.envelope().tick);
            for ticks in ticks.chunks(batch) {
                for tick in ticks {
                    let missed = u64::from(*tick >= 100) + u64::from(*tick >= 115);
                    let epoch = u64::from(*tick >= 300);
                    excerpt.take(state(*tick, missed, epoch), &mut keep);
                }
                for tick in ticks {
                    excerpt.take(wrench(*tick), &mut keep);
                }
            }
            excerpt.finish(keep);
            let ranges = [0..=10, 90..=125, 290..=310, 490..=500];
            let expected: Vec<u64> = ranges.into_iter().flatten().collect();
            assert_eq!(kept, [expected.clone(), expected], "{batch} at a time");
            let left_out = (excerpt.stretches, excerpt.left_out);
            assert_eq!(left_out, (4, [422, 0, 422, 0, 0, 0, 0, 0]));
        }
    }

    #[test]
    fn a_miss_among_skipped_ticks_may_be_of_any_of_them() {
        let mut excerpt = EventLog::new(5);
        let mut kept = Vec::new();
        for tick in (0..=50).chain(90..=120) {
            let mut keep = |entry: &LogEntry| kept.push(entry.envelope().tick);
            excerpt.take(state(tick, u64::from(tick >= 90), 0), &mut keep);
        }
        let ranges = [0..=5, 46..=50, 90..=95];
        assert_eq!(kept, Vec::from_iter(ranges.into_iter().flatten()));
    }

    #[test]
    fn what_waits_is_bounded_by_what_is_kept_around_an_event() {
        let mut excerpt = EventLog::new(1000);
        for tick in 0..100_000 {
            excerpt.take(state(tick, tick / 3000, 0), |_| ());
            excerpt.take(wrench(tick), |_| ());
            let (waiting, kept) = (excerpt.waiting.len(), excerpt.kept.len());
            assert!(waiting <= 2 * 1001 && kept < 20, "at tick {tick}");
        }
        // It would wait for what it has forgotten, were nothing left out.
        assert!(excerpt.left_out[0] > 30_000, "{:?}", excerpt.left_out);
        // A swap is kept, wherever it is.
        let swap = Message::of_tick(50, SwapRecord::default());
        let mut kept = 0;
        excerpt.take(LogEntry::Swap(swap), |_| kept += 1);
        assert_eq!(kept, 1);
    }
}
