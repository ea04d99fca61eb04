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

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use messages::content::{Mode, State};
use messages::grid::Grid;
use messages::header::{Header, Message};

/// Follows a flight's states and commands; skipped ticks are counted by the plant.
#[derive(Clone, Debug, Default)]
pub struct FreshnessStatistics {
    /// Ticks that ran, and whose command was late or never came.
    pub missed: u64,
    /// Ticks whose command was on time, but came of an older input.
    pub stale: u64,
    last: Option<Judged>,
    /// Ticks with a command on time, as far as the plant's counters tell; their commands are not decided yet.
    on_time: VecDeque<OnTime>,
    /// Commands whose deadlines the plant has not judged yet.
    commands: BTreeMap<u64, Command>,
    /// Ticks in which the outer or the inner stage held an older input.
    held: BTreeSet<u64>,
    /// The newest tick of outer, inner and mixer stage that was seen.
    seen: [Option<u64>; 3],
}

#[derive(Clone, Copy, Debug)]
struct Judged {
    tick: u64,
    missed: u64,
    skipped: u64,
}

#[derive(Clone, Copy, Debug)]
struct OnTime {
    tick: u64,
    /// Ticks behind it were skipped, and not all of them missed: only the stamps tell which command was late.
    by_stamps: bool,
}

#[derive(Clone, Copy, Debug)]
struct Command {
    sent_ns: u64,
    is_fresh: bool,
}

const fn held(mode: Mode) -> bool {
    matches!(mode, Mode::Held | Mode::Fallback | Mode::Idle)
}

impl FreshnessStatistics {
    pub fn join(&mut self, state: &State) {
        // A skipped tick has no command either, and counts as skipped alone.
        self.missed = state.deadlines_missed.saturating_sub(state.ticks_skipped);
    }

    /// Takes a state, with the plant's verdicts on the ticks before; `follows_loss`: states before it were not seen.
    pub fn state(&mut self, message: &Message<State>, follows_loss: bool) {
        let state = &message.content;
        let now = Judged {
            tick: message.envelope.tick,
            missed: state.deadlines_missed,
            skipped: state.ticks_skipped,
        };
        self.judge(now, follows_loss);
        self.last = Some(now);
    }

    fn judge(&mut self, now: Judged, follows_loss: bool) {
        let Some(last) = self.last else { return };
        let missed = now.missed.saturating_sub(last.missed);
        let skipped = now.skipped.saturating_sub(last.skipped);
        if follows_loss {
            self.missed += missed.saturating_sub(skipped);
        } else if missed > skipped {
            self.missed += 1;
        } else {
            let (tick, by_stamps) = (last.tick, missed > 0);
            self.on_time.push_back(OnTime { tick, by_stamps });
        }
    }

    /// Takes what the outer (0) or the inner stage (1) did in a tick.
    pub fn stage(&mut self, stage: usize, tick: u64, mode: u64) {
        self.seen[stage] = self.seen[stage].max(Some(tick));
        if Mode::from_wire(mode).is_none_or(held) {
            self.held.insert(tick);
        }
    }

    pub fn command(&mut self, envelope: &Header, sent_ns: u64, mode: u64) {
        let tick = envelope.tick;
        self.seen[2] = self.seen[2].max(Some(tick));
        let is_fresh = envelope.input_tick == [tick; 3] && !Mode::from_wire(mode).is_none_or(held);
        self.commands.insert(tick, Command { sent_ns, is_fresh });
    }

    /// Decides what is known by now; all that is left, once the flight is over.
    pub fn decide(&mut self, grid: Option<Grid>, is_over: bool) {
        while let Some(OnTime { tick, by_stamps }) = self.on_time.front().copied() {
            let is_seen = |stage: usize| is_over || self.seen[stage] >= Some(tick);
            let command = self.commands.get(&tick).copied();
            if !is_seen(2) || command.is_some_and(|it| it.is_fresh && !(is_seen(0) && is_seen(1))) {
                break;
            }
            let end_ns = grid.map(|grid| grid.begin_of(tick + 1));
            let is_late = |command: Command| end_ns.is_some_and(|end_ns| command.sent_ns > end_ns);
            match command {
                None => self.missed += u64::from(by_stamps),
                Some(command) if by_stamps && is_late(command) => self.missed += 1,
                Some(command) => {
                    self.stale += u64::from(!command.is_fresh || self.held.contains(&tick));
                }
            }
            self.on_time.pop_front();
        }
        let next = self.on_time.front().map(|it| it.tick);
        let oldest = next.or(self.last.map(|last| last.tick)).unwrap_or(0);
        self.commands = self.commands.split_off(&oldest);
        self.held = self.held.split_off(&oldest);
    }

    /// The flight is over: the plant's last verdicts, where it gave any after its last state.
    pub fn finish(&mut self, next_tick: u64, missed: u64, skipped: u64, grid: Option<Grid>) {
        let is_lost = |last: Judged| next_tick - last.tick > 1 + skipped - last.skipped;
        let follows_loss = self.last.is_some_and(is_lost);
        let now = Judged {
            tick: next_tick,
            missed,
            skipped,
        };
        self.judge(now, follows_loss);
        self.decide(grid, true);
    }
}

#[cfg(test)]
mod tests {
    use messages::content::NO_TICK;

    use super::*;

    const GRID: Grid = Grid {
        t0_ns: 0,
        period_ns: 1_000,
    };
    const FRESH: [Mode; 3] = [Mode::Fresh; 3];

    fn state(statistics: &mut FreshnessStatistics, tick: u64, missed: u64, skipped: u64) {
        let mut message = Message::of_tick(tick, State::default());
        message.content.deadlines_missed = missed;
        message.content.ticks_skipped = skipped;
        statistics.state(&message, false);
        statistics.decide(Some(GRID), false);
    }

    /// Each stage publishes in a tick; the inputs are the ticks of state, setpoint and wrench.
    fn stages(statistics: &mut FreshnessStatistics, tick: u64, inputs: [u64; 3], modes: [Mode; 3]) {
        let mut envelope = Header::new();
        (envelope.tick, envelope.input_tick) = (tick, inputs);
        statistics.stage(0, tick, modes[0] as u64);
        statistics.stage(1, tick, modes[1] as u64);
        statistics.command(&envelope, GRID.begin_of(tick) + 100, modes[2] as u64);
        statistics.decide(Some(GRID), false);
    }

    fn counts(statistics: &FreshnessStatistics) -> (u64, u64) {
        (statistics.missed, statistics.stale)
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
            state(&mut statistics, 7, 0, 0);
            stages(&mut statistics, 7, inputs, modes);
            assert_eq!(counts(&statistics), (0, 0), "not judged yet");
            state(&mut statistics, 8, 0, 0);
            assert_eq!(counts(&statistics), (0, stale), "{inputs:?} {modes:?}");
        }
    }

    #[test]
    fn states_may_be_seen_before_the_commands_that_they_judge() {
        let mut statistics = FreshnessStatistics::default();
        (0..4).for_each(|tick| state(&mut statistics, tick, 0, 0));
        stages(&mut statistics, 0, [0; 3], FRESH);
        stages(&mut statistics, 1, [1, 1, 0], FRESH);
        stages(&mut statistics, 2, [2, 2, 0], FRESH);
        assert_eq!(counts(&statistics), (0, 2));
    }

    #[test]
    fn each_tick_counts_once() {
        let mut statistics = FreshnessStatistics::default();
        state(&mut statistics, 0, 0, 0);
        stages(&mut statistics, 0, [0; 3], FRESH);
        // The command of tick 1 is late, and it is of an older input.
        state(&mut statistics, 1, 0, 0);
        state(&mut statistics, 2, 1, 0);
        stages(&mut statistics, 1, [1, 1, 0], FRESH);
        assert_eq!(counts(&statistics), (1, 0));
        // Ticks 3 to 5 were skipped; there was no command for them, and that of tick 2 was on time.
        stages(&mut statistics, 2, [2; 3], FRESH);
        state(&mut statistics, 6, 4, 3);
        assert_eq!(counts(&statistics), (1, 0));
        // The plant sleeps once more, and the command of tick 6 is missing, too.
        state(&mut statistics, 8, 6, 4);
        assert_eq!(counts(&statistics), (2, 0));
        stages(&mut statistics, 8, [8, 8, 2], FRESH);
        statistics.finish(9, 6, 4, Some(GRID));
        assert_eq!(counts(&statistics), (2, 1));
        // A recorder that joins counts earlier ticks as far as the plant reports them.
        let mut joined = FreshnessStatistics::default();
        joined.join(&State {
            deadlines_missed: 7,
            ticks_skipped: 5,
            ..State::default()
        });
        assert_eq!(counts(&joined), (2, 0));
    }
}
