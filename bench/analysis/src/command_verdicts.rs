//! Which ticks began without the command of the tick before, by the plant's record of the commands that it took.

use messages::content::{NO_TICK, State, TakenCommand};

#[derive(Clone, Debug, Default)]
pub struct CommandVerdicts {
    /// Commands that act later: their ticks, and those from which on they act.
    pending: Vec<(u64, u64)>,
    /// Tick of the command in force.
    newest: Option<u64>,
    /// The next tick to judge.
    next: u64,
}

impl CommandVerdicts {
    pub fn take(&mut self, command: &TakenCommand) {
        if command.acts_from != NO_TICK {
            self.pending.push((command.of_tick, command.acts_from));
        }
    }

    /// Judges the ticks up to this one, whose decisions have been taken; gives those that missed to `missed`.
    pub fn judge(&mut self, tick: u64, mut missed: impl FnMut(u64)) {
        for judged in self.next..=tick {
            let acting = self.pending.iter().filter(|(_, from)| *from <= judged);
            self.newest = self.newest.max(acting.map(|(made_for, _)| *made_for).max());
            self.pending.retain(|(_, from)| *from > judged);
            // No stage could compute a command for the first tick.
            if judged > 0 && self.newest != Some(judged - 1) {
                missed(judged);
            }
        }
        self.next = tick + 1;
    }

    /// Continues from a state before which decisions are missing.
    pub fn resume(&mut self, tick: u64, state: &State) {
        self.pending.clear();
        self.newest = (state.command_tick != NO_TICK).then_some(state.command_tick);
        self.next = tick + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(verdicts: &mut CommandVerdicts, commands: &[(u64, u64)]) {
        for (tick, acts_from) in commands {
            verdicts.take(&TakenCommand {
                of_tick: *tick,
                acts_from: *acts_from,
                ..TakenCommand::default()
            });
        }
    }

    #[test]
    fn a_tick_misses_if_no_command_of_the_tick_before_acts_in_it() {
        let mut verdicts = CommandVerdicts::default();
        let judge = |verdicts: &mut CommandVerdicts, tick| {
            let mut missed = Vec::new();
            verdicts.judge(tick, |it| missed.push(it));
            missed
        };
        assert!(judge(&mut verdicts, 0).is_empty());
        // The plant skipped the first ticks.
        assert_eq!(judge(&mut CommandVerdicts::default(), 3), [1, 2, 3]);
        take(&mut verdicts, &[(0, 1)]);
        assert!(judge(&mut verdicts, 1).is_empty());
        // Dropped by a fault.
        take(&mut verdicts, &[(1, NO_TICK)]);
        assert_eq!(judge(&mut verdicts, 2), [2]);
        // The plant was stopped: one command was late by a tick, and one never came.
        take(&mut verdicts, &[(2, 3), (3, 5), (4, 5), (6, 7)]);
        assert_eq!(judge(&mut verdicts, 7), [4, 6]);
        verdicts.resume(
            20,
            &State {
                command_tick: 19,
                ..State::default()
            },
        );
        assert_eq!(judge(&mut verdicts, 21), [21]);
    }
}
