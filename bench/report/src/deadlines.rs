//! Deadlines of the rotor commands, from their stamps: slack, lateness, miss runs.
//!
//! The command of tick k must be published before t_k+1. A command that never came counts as late until the next one
//! that did. No tick is left out because nobody was there to measure it (no coordinated omission).

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

/// Follows the rotor commands of a run.
#[derive(Clone, Debug)]
pub struct Deadlines {
    grid: Grid,
    /// Tick of the next command that is owed; none before the first that comes to one who joins a flight.
    owed_tick: Option<u64>,
}

impl Deadlines {
    pub const fn new(grid: Grid) -> Self {
        Self {
            grid,
            owed_tick: Some(0),
        }
    }

    /// From the first command on that comes.
    pub const fn joining(grid: Grid) -> Self {
        Self {
            grid,
            owed_tick: None,
        }
    }

    /// Judges the deadlines of all commands owed up to that of `tick`, which was published at `send_ns`; `judge` is
    /// told the tick of each.
    pub fn published(
        &mut self,
        tick: u64,
        send_ns: u64,
        mut judge: impl FnMut(u64, DeadlineOutcome),
    ) {
        let first_owed = self.owed_tick.unwrap_or(tick);
        for owed in first_owed..=tick {
            let deadline_ns = self.grid.begin_of(owed + 1);
            let verdict = match deadline_ns.checked_sub(send_ns) {
                Some(slack_ns) => DeadlineOutcome::Slack(slack_ns),
                None => DeadlineOutcome::Late(send_ns - deadline_ns),
            };
            judge(owed, verdict);
        }
        self.owed_tick = Some(first_owed.max(tick + 1));
    }

    /// Owes nothing from before a tick: commands were published, and nobody has seen them.
    pub fn unseen_before(&mut self, tick: u64) {
        self.owed_tick = self.owed_tick.max(Some(tick));
    }

    /// Judges the deadlines that a flight still owed up to `last_tick`, when it ended at `end_ns`: no stage published.
    pub fn finish(
        &mut self,
        last_tick: u64,
        end_ns: u64,
        mut judge: impl FnMut(u64, DeadlineOutcome),
    ) {
        for owed in self.owed_tick.unwrap_or(last_tick + 1)..=last_tick {
            judge(
                owed,
                DeadlineOutcome::Late(end_ns.saturating_sub(self.grid.begin_of(owed + 1))),
            );
        }
        self.owed_tick = self.owed_tick.max(Some(last_tick + 1));
    }
}

/// The first late commands, those of consecutive ticks together.
#[derive(Clone, Debug, Default)]
pub struct LateCommands {
    count: u64,
    stretches: Vec<LateStretch>,
    last: Option<u64>,
    left_out: u64,
}

/// Consecutive ticks whose commands were late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateStretch {
    pub tick: u64,
    pub length_ticks: u64,
    /// Largest lateness [ns].
    pub late_ns: u64,
}

impl LateCommands {
    /// Takes the lateness [ns] of the command of a tick.
    pub fn take(&mut self, tick: u64, late_ns: u64) {
        self.count += 1;
        let continues = self.last.is_some_and(|last| last + 1 == tick);
        self.last = Some(tick);
        let has_room = self.stretches.len() < KEPT;
        match self.stretches.last_mut() {
            // One that was left out has no entry to be continued.
            Some(stretch) if continues && self.left_out == 0 => {
                stretch.length_ticks += 1;
                stretch.late_ns = stretch.late_ns.max(late_ns);
            }
            _ if has_room => self.stretches.push(LateStretch {
                tick,
                length_ticks: 1,
                late_ns,
            }),
            _ => self.left_out += 1,
        }
    }

    pub const fn count(&self) -> u64 {
        self.count
    }

    /// The first [`KEPT`] stretches.
    pub fn stretches(&self) -> &[LateStretch] {
        &self.stretches
    }

    pub const fn left_out(&self) -> u64 {
        self.left_out
    }
}

/// Lengths of the runs of consecutive misses, from the plant's own verdicts.
///
/// A state message says how many deadlines were missed so far and how long the present run is. Ticks that the
/// plant skipped are judged in between, so runs may have ended and begun unseen. All misses that do not belong to
/// the present run then count as the rest of the last one.
#[derive(Clone, Debug, Default)]
pub struct MissRuns {
    missed: u64,
    run: u64,
    lengths: BTreeMap<u64, u64>,
}

impl MissRuns {
    /// From the counters of a flight under way on: what was missed before is part of no run, a run under way is.
    pub fn joining(missed: u64, run: u64) -> Self {
        Self {
            missed,
            run,
            lengths: BTreeMap::new(),
        }
    }

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

    /// Takes the counters of a state before which others were published that nobody has seen: what was missed meanwhile
    /// is part of no run.
    pub fn unseen(&mut self, missed: u64, run: u64) {
        (self.missed, self.run) = (missed, run);
    }

    fn end(&mut self, length: u64) {
        if length > 0 {
            *self.lengths.entry(length).or_default() += 1;
        }
    }

    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// How many runs there were of each length; the one that has not ended counts with its present length.
    pub fn lengths(&self) -> BTreeMap<u64, u64> {
        let mut all = self.clone();
        all.end(self.run);
        all.lengths
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid {
        t0_ns: 0,
        period_ns: 1_000,
    };

    fn verdicts(published: &[(u64, u64)]) -> Vec<DeadlineOutcome> {
        let mut deadlines = Deadlines::new(GRID);
        let mut all = Vec::new();
        for (tick, send_ns) in published {
            deadlines.published(*tick, *send_ns, |_, verdict| all.push(verdict));
        }
        all
    }

    #[test]
    fn commands_in_time_have_slack() {
        assert_eq!(
            verdicts(&[(0, 30), (1, 1_400)]),
            [DeadlineOutcome::Slack(970), DeadlineOutcome::Slack(600)]
        );
    }

    #[test]
    fn a_late_command_is_late_by_what_it_is_late() {
        assert_eq!(verdicts(&[(0, 1_001)]), [DeadlineOutcome::Late(1)]);
    }

    #[test]
    fn commands_that_never_came_are_late_until_the_next_one() {
        let all = verdicts(&[(0, 30), (3, 3_040)]);
        assert_eq!(
            all,
            [
                DeadlineOutcome::Slack(970),
                DeadlineOutcome::Late(1_040),
                DeadlineOutcome::Late(40),
                DeadlineOutcome::Slack(960)
            ]
        );
    }

    #[test]
    fn an_outage_that_ends_the_flight_is_late_until_its_end() {
        let mut deadlines = Deadlines::new(GRID);
        let mut all = Vec::new();
        deadlines.published(0, 30, |_, _| {});
        deadlines.finish(3, 4_100, |tick, verdict| all.push((tick, verdict)));
        assert_eq!(
            all,
            [
                (1, DeadlineOutcome::Late(2_100)),
                (2, DeadlineOutcome::Late(1_100)),
                (3, DeadlineOutcome::Late(100))
            ]
        );
        deadlines.finish(3, 4_100, |_, _| panic!("judged twice"));
        Deadlines::joining(GRID).finish(3, 4_100, |_, _| panic!("it has seen nothing"));
    }

    #[test]
    fn what_was_published_and_not_seen_is_not_late() {
        let mut deadlines = Deadlines::new(GRID);
        let mut all = Vec::new();
        deadlines.unseen_before(3);
        deadlines.published(3, 3_040, |tick, verdict| all.push((tick, verdict)));
        assert_eq!(all, [(3, DeadlineOutcome::Slack(960))]);
        let mut runs = MissRuns::default();
        runs.unseen(14, 0);
        runs.update(16, 2);
        assert_eq!(
            (runs.missed(), runs.lengths()),
            (16, BTreeMap::from([(2, 1)]))
        );
    }

    #[test]
    fn one_who_joins_a_flight_is_owed_nothing_from_before() {
        let mut deadlines = Deadlines::joining(GRID);
        let mut all = Vec::new();
        for (tick, send_ns) in [(7, 7_030), (9, 9_040)] {
            deadlines.published(tick, send_ns, |_, verdict| all.push(verdict));
        }
        assert_eq!(
            all,
            [
                DeadlineOutcome::Slack(970),
                DeadlineOutcome::Late(40),
                DeadlineOutcome::Slack(960)
            ]
        );
        let mut runs = MissRuns::joining(70, 2);
        for (missed, run) in [(71, 3), (71, 0), (72, 1)] {
            runs.update(missed, run);
        }
        assert_eq!(
            (runs.missed(), runs.lengths()),
            (72, BTreeMap::from([(1, 1), (3, 1)]))
        );
    }

    #[test]
    fn late_commands_of_consecutive_ticks_stand_together() {
        let mut late = LateCommands::default();
        for (tick, late_ns) in [(7, 40), (8, 90), (9, 30), (11, 5)] {
            late.take(tick, late_ns);
        }
        let expected = [
            LateStretch {
                tick: 7,
                length_ticks: 3,
                late_ns: 90,
            },
            LateStretch {
                tick: 11,
                length_ticks: 1,
                late_ns: 5,
            },
        ];
        assert_eq!(
            (late.stretches(), late.count(), late.left_out()),
            (&expected[..], 4, 0)
        );
    }

    #[test]
    fn late_commands_beyond_those_kept_are_counted() {
        let mut late = LateCommands::default();
        (0..KEPT as u64).for_each(|i| late.take(2 * i, 1));
        let next = 2 * KEPT as u64;
        (next..next + 3).for_each(|tick| late.take(tick, 1));
        assert_eq!(
            (late.stretches().len(), late.count(), late.left_out()),
            (KEPT, KEPT as u64 + 3, 3)
        );
        let last = late.stretches().last().unwrap();
        assert_eq!((last.tick, last.length_ticks), (next - 2, 1));
    }

    #[test]
    fn runs_are_counted_by_length() {
        let mut runs = MissRuns::default();
        // missed, run: one miss; in time; two in a row; in time; then a skipped stretch with one command in it.
        for (missed, run) in [
            (0, 0),
            (1, 1),
            (1, 0),
            (2, 1),
            (3, 2),
            (3, 0),
            (4, 1),
            (9, 3),
        ] {
            runs.update(missed, run);
        }
        assert_eq!(runs.lengths(), BTreeMap::from([(1, 1), (2, 1), (3, 2)]));
        assert_eq!(runs.missed(), 9);
        assert_eq!(
            runs.lengths()
                .iter()
                .map(|(length, count)| length * count)
                .sum::<u64>(),
            9
        );
    }
}
