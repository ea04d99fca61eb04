//! Deadlines of the rotor commands, from their stamps: slack, lateness, runs of misses.
//!
//! The command of tick k must be published before t_k+1. One that never came is late until the next one that
//! did: nothing is left out because nobody was there to measure it (no coordinated omission).

use std::collections::BTreeMap;

use shared::clock::Grid;

/// What a rotor command says about the deadlines since the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Published this long before the deadline [ns].
    Slack(u64),
    /// The deadline passed this long before a command came [ns].
    Late(u64),
}

/// Follows the rotor commands of a run.
#[derive(Clone, Debug)]
pub struct Deadlines {
    grid: Grid,
    /// Tick of the next command that is owed.
    owed_tick: u64,
}

impl Deadlines {
    /// From tick 0 on.
    #[must_use]
    pub const fn new(grid: Grid) -> Self {
        Self { grid, owed_tick: 0 }
    }

    /// Judges the deadlines of all commands owed up to that of `tick`, which was published at `send_ns`.
    pub fn published(&mut self, tick: u64, send_ns: u64, mut judge: impl FnMut(Verdict)) {
        for owed in self.owed_tick..=tick {
            let deadline_ns = self.grid.begin_of(owed + 1);
            judge(match deadline_ns.checked_sub(send_ns) {
                Some(slack_ns) => Verdict::Slack(slack_ns),
                None => Verdict::Late(send_ns - deadline_ns),
            });
        }
        self.owed_tick = self.owed_tick.max(tick + 1);
    }
}

/// Lengths of the runs of consecutive misses, from the plant's own verdicts.
///
/// A state message says how many deadlines were missed so far and how long the present run is. Ticks that the
/// plant skipped are judged in between, so runs may have ended and begun unseen: at most one of each, because
/// at most one command can have come into force meanwhile.
#[derive(Clone, Debug, Default)]
pub struct MissRuns {
    missed: u64,
    run: u64,
    lengths: BTreeMap<u64, u64>,
}

impl MissRuns {
    /// Takes the counters of the next state message.
    pub fn update(&mut self, missed: u64, run: u64) {
        let new = missed.saturating_sub(self.missed);
        if run < self.run + new {
            // What of the new misses does not belong to the present run still belonged to the last one.
            self.end(self.run + new - run.min(new));
        }
        self.missed = missed;
        self.run = run;
    }

    fn end(&mut self, length: u64) {
        if length > 0 {
            *self.lengths.entry(length).or_default() += 1;
        }
    }

    /// Deadlines missed.
    #[must_use]
    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// How many runs there were of each length; the one that has not ended counts with its present length.
    #[must_use]
    pub fn lengths(&self) -> BTreeMap<u64, u64> {
        let mut all = self.clone();
        all.end(self.run);
        all.lengths
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { t0_ns: 0, period_ns: 1_000 };

    fn verdicts(published: &[(u64, u64)]) -> Vec<Verdict> {
        let mut deadlines = Deadlines::new(GRID);
        let mut all = Vec::new();
        for (tick, send_ns) in published {
            deadlines.published(*tick, *send_ns, |verdict| all.push(verdict));
        }
        all
    }

    #[test]
    fn commands_in_time_have_slack() {
        assert_eq!(verdicts(&[(0, 30), (1, 1_400)]), [Verdict::Slack(970), Verdict::Slack(600)]);
    }

    #[test]
    fn a_late_command_is_late_by_what_it_is_late() {
        assert_eq!(verdicts(&[(0, 1_001)]), [Verdict::Late(1)]);
    }

    #[test]
    fn commands_that_never_came_are_late_until_the_next_one() {
        let all = verdicts(&[(0, 30), (3, 3_040)]);
        assert_eq!(all, [Verdict::Slack(970), Verdict::Late(1_040), Verdict::Late(40), Verdict::Slack(960)]);
    }

    #[test]
    fn runs_are_counted_by_length() {
        let mut runs = MissRuns::default();
        // missed, run: one miss; in time; two in a row; in time; then a skipped stretch with one command in it.
        for (missed, run) in [(0, 0), (1, 1), (1, 0), (2, 1), (3, 2), (3, 0), (4, 1), (9, 3)] {
            runs.update(missed, run);
        }
        assert_eq!(runs.lengths(), BTreeMap::from([(1, 1), (2, 1), (3, 2)]));
        assert_eq!(runs.missed(), 9);
        assert_eq!(runs.lengths().iter().map(|(length, count)| length * count).sum::<u64>(), 9);
    }
}
