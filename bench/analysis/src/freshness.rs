//! Ticks that flew without a fresh command on time.
//!
//! A command is fresh when every stage computed it from the state of its tick. Each tick counts once:
//!
//! | the tick | counts as |
//! |---|---|
//! | was skipped by the plant, so it has no state | skipped |
//! | ran, and its command was late or never came | missed |
//! | ran, its command was on time, but a stage had worked with an older input | stale |
//! | anything else | fresh |

use std::collections::BTreeSet;

use messages::content::{Mode, State};
use messages::header::Header;

/// Follows a flight's commands; skipped ticks are counted by the plant.
#[derive(Clone, Debug, Default)]
pub struct FreshnessStatistics {
    /// Ticks that ran, and whose command was late or never came.
    pub missed: u64,
    /// Ticks whose command was on time, but came of an older input.
    pub stale: u64,
    /// Ticks in which a stage worked with an older input.
    old: BTreeSet<u64>,
}

const fn held(mode: Mode) -> bool {
    matches!(mode, Mode::Held | Mode::Fallback | Mode::Idle)
}

impl FreshnessStatistics {
    pub fn join(&mut self, state: &State) {
        // A skipped tick has no command either, and counts as skipped alone.
        self.missed = state.deadlines_missed.saturating_sub(state.ticks_skipped);
    }

    /// Takes how a stage worked in a tick.
    pub fn stage(&mut self, tick: u64, mode: u64) {
        if Mode::from_wire(mode).is_none_or(held) {
            self.old.insert(tick);
        }
    }

    pub fn command(&mut self, envelope: &Header, mode: u64) {
        self.stage(envelope.tick, mode);
        if envelope.input_tick != [envelope.tick; 3] {
            self.old.insert(envelope.tick);
        }
    }

    /// Takes the verdict on the command of a tick that ran. What the stages did in it has been taken.
    pub fn judge(&mut self, tick: u64, has_missed: bool) {
        if has_missed {
            self.missed += 1;
        } else {
            self.stale += u64::from(self.old.contains(&tick));
        }
        self.old = self.old.split_off(&tick);
    }
}

#[cfg(test)]
mod tests {
    use messages::content::NO_TICK;

    use super::*;

    const FRESH: [Mode; 3] = [Mode::Fresh; 3];

    /// Each stage publishes in a tick; the inputs are the ticks of state, setpoint and wrench.
    fn stages(statistics: &mut FreshnessStatistics, tick: u64, inputs: [u64; 3], modes: [Mode; 3]) {
        let mut envelope = Header::new();
        (envelope.tick, envelope.input_tick) = (tick, inputs);
        statistics.stage(tick, modes[0] as u64);
        statistics.stage(tick, modes[1] as u64);
        statistics.command(&envelope, modes[2] as u64);
    }

    #[test]
    fn a_command_is_fresh_when_every_stage_worked_with_its_tick() {
        use Mode::{Fallback, Fresh, Held, NotFinite};
        for (inputs, modes, stale) in [
            ([7, 7, 7], FRESH, 0),
            ([6, 7, 7], FRESH, 1),
            ([7, 6, 7], FRESH, 1),
            ([7, 7, 6], FRESH, 1),
            ([7, 7, NO_TICK], FRESH, 1),
            ([7, 7, 7], [Fresh, Held, Fresh], 1),
            ([7, 7, 7], [Fresh, Fresh, Held], 1),
            ([7, 7, 7], [Fallback, Fresh, Fresh], 1),
            // What the law answered is no matter of time.
            ([7, 7, 7], [Fresh, NotFinite, Fresh], 0),
        ] {
            let mut statistics = FreshnessStatistics::default();
            stages(&mut statistics, 7, inputs, modes);
            statistics.judge(7, false);
            let counts = (statistics.missed, statistics.stale);
            assert_eq!(counts, (0, stale), "{inputs:?} {modes:?}");
        }
    }

    #[test]
    fn each_tick_counts_once() {
        let mut statistics = FreshnessStatistics::default();
        // The command of tick 1 is late, and it is of an older input.
        stages(&mut statistics, 1, [1, 1, 0], FRESH);
        statistics.judge(1, true);
        // The recorder did not receive the message of tick 2.
        statistics.judge(2, false);
        assert_eq!((statistics.missed, statistics.stale), (1, 0));
        // A recorder that joins counts earlier ticks as far as the plant reports them.
        let mut joined = FreshnessStatistics::default();
        joined.join(&State {
            deadlines_missed: 7,
            ticks_skipped: 5,
            ..State::default()
        });
        assert_eq!((joined.missed, joined.stale), (2, 0));
    }
}
