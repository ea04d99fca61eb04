//! The longest rows of ticks in which stages were out: what a flight's margin is held against.

use std::collections::BTreeMap;

use model::grid::Grid;
use model::role::STAGES;

use crate::autopsy::Outage;
use crate::autopsy::evidence::TickPassages;
use crate::margin::line::MACHINE;

/// Each stage, and all of them at once.
const ROWS: usize = STAGES.len() + 1;

/// The longest rows so far, of each stage and of all at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows {
    longest: [u64; ROWS],
    /// Rows that last at the end of the outage that was taken last.
    running: [u64; ROWS],
    /// The tick behind that outage.
    next: u64,
    /// Outages whose rows are not known.
    pub unmeasured: u64,
}

impl Rows {
    pub const NONE: Self = Self { longest: [0; ROWS], running: [0; ROWS], next: 0, unmeasured: 0 };

    /// Takes an outage, whose stages were out as `out_in` says of each tick. One that begins where the last one was cut
    /// off goes on with it.
    pub fn take(&mut self, outage: Outage, out_in: impl Fn(u64) -> [bool; STAGES.len()]) {
        if outage.first != self.next {
            self.running = [0; ROWS];
        }
        self.next = outage.last + 1;
        for tick in outage.first..=outage.last {
            let out = out_in(tick);
            let all = out.iter().all(|is_out| *is_out);
            let rows = self.running.iter_mut().zip(&mut self.longest);
            for ((row, longest), is_out) in rows.zip(out.into_iter().chain([all])) {
                *row = if is_out { *row + 1 } else { 0 };
                *longest = (*longest).max(*row);
            }
        }
    }

    /// The longest of each stage that had one, and of [`MACHINE`] [ticks].
    pub fn longest(&self) -> BTreeMap<String, u64> {
        let names = STAGES.into_iter().map(|role| role.name()).chain([MACHINE]);
        let longest = names.zip(self.longest).filter(|(_, ticks)| *ticks > 0);
        longest.map(|(name, ticks)| (name.to_owned(), ticks)).collect()
    }
}

/// Which stages published nothing in a tick, or too late for the next one. What came in time and was not used is no
/// outage of its sender; `is_missed` says that the tick's command missed its deadline.
pub(super) fn out_in(trace: &TickPassages, grid: Grid, tick: u64, is_missed: bool) -> [bool; STAGES.len()] {
    std::array::from_fn(|i| {
        let Some(passage) = trace[i] else { return true };
        let (due_ns, is_used) = match STAGES.get(i + 1) {
            Some(next) => (grid.cut_off_of(*next, tick), trace[i + 1].is_some_and(|next| next.is_fresh)),
            None => (grid.begin_of(tick + 1), !is_missed),
        };
        !is_used && passage.send_ns > due_ns
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn longest(outages: &[(u64, u64)], out_in: fn(u64) -> [bool; STAGES.len()]) -> Vec<u64> {
        let mut rows = Rows::NONE;
        outages.iter().for_each(|(first, last)| rows.take(Outage { first: *first, last: *last, missed: 0 }, out_in));
        rows.longest.into()
    }

    #[test]
    fn an_outage_that_was_cut_off_goes_on_and_another_one_does_not() {
        let inner = |_| [false, false, true, false];
        assert_eq!(longest(&[(100, 199), (200, 249)], inner), [0, 0, 150, 0, 0]);
        assert_eq!(longest(&[(100, 199), (201, 250)], inner), [0, 0, 100, 0, 0]);
    }

    #[test]
    fn a_stage_that_works_meanwhile_begins_a_new_row_and_the_machine_is_all_of_them() {
        let now_and_then = |tick: u64| [true, !tick.is_multiple_of(10), true, true];
        assert_eq!(longest(&[(1, 29)], now_and_then), [29, 9, 29, 29, 9]);
    }
}
