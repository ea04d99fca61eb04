//! Deadlines of the rotor commands, from their stamps: slack, lateness, miss runs.
//!
//! The command of tick k must be published before t_k+1. A command that never came counts as late until the next one
//! that did. No tick is left out because no message measured it (no coordinated omission).

use crate::schema::{LateStretchSection, RunLength};
use messages::grid::Grid;
use std::collections::BTreeMap;

/// Stretches of late commands that are kept one by one.
pub const KEPT: usize = 500;

/// What a rotor command says about the deadline of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeadlineOutcome {
    /// Published this long before the deadline [ns].
    Slack(u64),
    /// The deadline passed this long before a command came [ns].
    Late(u64),
}

pub type Judged = (u64, DeadlineOutcome);

#[derive(Clone, Debug)]
pub struct Deadlines {
    grid: Grid,
    /// Tick of the next command that is owed; none before the first that comes to one who joins a flight.
    owed_tick: Option<u64>,
}

impl Deadlines {
    pub fn new(grid: Grid, joins: bool) -> Self {
        Self {
            grid,
            owed_tick: (!joins).then_some(0),
        }
    }

    /// Judges the deadlines of all commands owed up to that of `tick`, which was published at `send_ns`.
    pub fn judge(&mut self, tick: u64, send_ns: u64) -> impl Iterator<Item = Judged> + use<> {
        let (grid, first_owed) = (self.grid, self.owed_tick.unwrap_or(tick));
        self.owed_tick = Some(first_owed.max(tick + 1));
        (first_owed..=tick).map(move |owed| {
            let deadline_ns = grid.begin_of(owed + 1);
            let slack_ns = deadline_ns.checked_sub(send_ns);
            let late = || DeadlineOutcome::Late(send_ns - deadline_ns);
            (owed, slack_ns.map_or_else(late, DeadlineOutcome::Slack))
        })
    }

    /// Ignores ticks before this one: their commands were published, but not received here.
    pub fn skip_before(&mut self, tick: u64) {
        self.owed_tick = self.owed_tick.max(Some(tick));
    }

    /// Judges the deadlines that a flight still owed up to `last_tick`, when it ended at `end_ns`: no stage published.
    pub fn finish(&mut self, last_tick: u64, end_ns: u64) -> impl Iterator<Item = Judged> + use<> {
        let (grid, next) = (self.grid, last_tick + 1);
        let first_owed = self.owed_tick.unwrap_or(next);
        self.owed_tick = self.owed_tick.max(Some(next));
        (first_owed..next).map(move |owed| {
            let late_ns = end_ns.saturating_sub(grid.begin_of(owed + 1));
            (owed, DeadlineOutcome::Late(late_ns))
        })
    }
}

#[derive(Clone, Debug, Default)]
pub struct LateCommands {
    pub count: u64,
    pub stretches: Vec<LateStretchSection>,
    last: Option<u64>,
    pub left_out: u64,
}

impl LateCommands {
    /// Takes the lateness [ns] of the command of a tick of `period_s`.
    pub fn take(&mut self, tick: u64, period_s: f64, late_ns: u64) {
        self.count += 1;
        let continues = self.last.is_some_and(|last| last + 1 == tick);
        self.last = Some(tick);
        let (has_room, late_us) = (self.stretches.len() < KEPT, late_ns as f64 / 1e3);
        match self.stretches.last_mut() {
            // One that was left out has no entry to be continued.
            Some(stretch) if continues && self.left_out == 0 => {
                stretch.length_ticks += 1;
                stretch.late_us = stretch.late_us.max(late_us);
            }
            _ if has_room => self.stretches.push(LateStretchSection {
                tick,
                time_s: tick as f64 * period_s,
                length_ticks: 1,
                late_us,
            }),
            _ => self.left_out += 1,
        }
    }
}

/// Lengths of the runs of consecutive misses, from the plant's own verdicts.
///
/// A state message says how many deadlines were missed so far and how long the present run is. Ticks that the
/// plant skipped are judged in between, so runs may have ended and begun unseen. All misses that do not belong to
/// the present run then count as the rest of the last one.
#[derive(Clone, Debug, Default)]
pub struct MissRuns {
    pub missed: u64,
    run: u64,
    lengths: BTreeMap<u64, u64>,
}

impl MissRuns {
    pub fn update(&mut self, missed: u64, run: u64) {
        let new = missed.saturating_sub(self.missed);
        if run < self.run + new {
            // What of the new misses does not belong to the present run still belonged to the last one.
            self.end(self.run + new - run.min(new));
        }
        self.missed = missed;
        self.run = run;
    }

    /// Takes the counters of a state that follows missed ones, or of the first state of a
    /// flight under way: what was missed before is part of no run, a run under way is.
    pub fn skip(&mut self, missed: u64, run: u64) {
        (self.missed, self.run) = (missed, run);
    }

    fn end(&mut self, length: u64) {
        if length > 0 {
            *self.lengths.entry(length).or_default() += 1;
        }
    }

    /// How many runs there were of each length; the one that has not ended counts with its present length.
    pub fn lengths(&self) -> Vec<RunLength> {
        let mut all = self.clone();
        all.end(self.run);
        let run = |(length_ticks, count)| RunLength {
            length_ticks,
            count,
        };
        all.lengths.into_iter().map(run).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::DeadlineOutcome::{Late, Slack};
    use super::*;

    const GRID: Grid = Grid {
        t0_ns: 0,
        period_ns: 1_000,
    };

    #[test]
    fn every_deadline_is_judged_by_the_next_command_that_came() {
        let check =
            |mut deadlines: Deadlines, sent: &[(u64, u64)], expected: &[DeadlineOutcome]| {
                let mut all = Vec::new();
                for (tick, send_ns) in sent {
                    all.extend(deadlines.judge(*tick, *send_ns).map(|(_, it)| it));
                }
                assert_eq!(all, expected, "{sent:?}");
            };
        let (new, joining) = (Deadlines::new(GRID, false), Deadlines::new(GRID, true));
        let mut unseen = new.clone();
        unseen.skip_before(3);
        let in_time = [Slack(970), Slack(600)];
        check(new.clone(), &[(0, 30), (1, 1_400)], &in_time);
        check(new.clone(), &[(0, 1_001)], &[Late(1)]);
        let lost = [Slack(970), Late(1_040), Late(40), Slack(960)];
        check(new, &[(0, 30), (3, 3_040)], &lost);
        // What was published and not seen is not late; a joined flight owes nothing from before.
        check(unseen, &[(3, 3_040)], &[Slack(960)]);
        let joined = [Slack(970), Late(40), Slack(960)];
        check(joining, &[(7, 7_030), (9, 9_040)], &joined);
    }

    #[test]
    fn an_outage_that_ends_the_flight_is_late_until_its_end() {
        let mut deadlines = Deadlines::new(GRID, false);
        assert_eq!(deadlines.judge(0, 30).count(), 1);
        let all: Vec<_> = deadlines.finish(3, 4_100).collect();
        assert_eq!(all, [(1, Late(2_100)), (2, Late(1_100)), (3, Late(100))]);
        assert_eq!(deadlines.finish(3, 4_100).count(), 0, "judged twice");
        let mut joined = Deadlines::new(GRID, true);
        assert_eq!(joined.finish(3, 4_100).count(), 0, "it has seen nothing");
    }

    #[test]
    fn late_commands_of_consecutive_ticks_stand_together_and_are_counted_beyond_those_kept() {
        let mut late = LateCommands::default();
        for (tick, late_ns) in [(7, 40), (8, 90), (9, 30), (11, 5)] {
            late.take(tick, 1e-3, late_ns);
        }
        let found = late.stretches.iter();
        let found: Vec<_> = found
            .map(|it| (it.tick, it.length_ticks, it.late_us))
            .collect();
        assert_eq!(found, [(7, 3, 0.09), (11, 1, 0.005)]);
        (10..8 + KEPT as u64).for_each(|i| late.take(2 * i, 1e-3, 1));
        let next = 2 * KEPT as u64 + 100;
        (next..next + 3).for_each(|tick| late.take(tick, 1e-3, 1));
        assert_eq!((late.stretches.len(), late.left_out), (KEPT, 3));
        assert_eq!(late.count, 4 + KEPT as u64 - 2 + 3);
        assert_eq!(late.stretches.last().unwrap().length_ticks, 1);
    }

    #[test]
    fn runs_are_counted_by_length() {
        let check = |mut runs: MissRuns, states: &[(u64, u64)], lengths: &[(u64, u64)]| {
            states
                .iter()
                .for_each(|(missed, run)| runs.update(*missed, *run));
            let found = runs.lengths().into_iter();
            assert!(
                found
                    .map(|it| (it.length_ticks, it.count))
                    .eq(lengths.iter().copied())
            );
            assert_eq!(Some(runs.missed), states.last().map(|it| it.0));
        };
        // missed, run: one miss; in time; two in a row; in time; then a skipped stretch with one command in it.
        let whole = [
            (0, 0),
            (1, 1),
            (1, 0),
            (2, 1),
            (3, 2),
            (3, 0),
            (4, 1),
            (9, 3),
        ];
        check(MissRuns::default(), &whole, &[(1, 1), (2, 1), (3, 2)]);
        let mut joining = MissRuns::default();
        joining.skip(70, 2);
        check(joining, &[(71, 3), (71, 0), (72, 1)], &[(1, 1), (3, 1)]);
    }
}
