//! The grid of ticks: instants, tick numbers, and what advances a run by a tick.
//!
//! Instants are in nanoseconds on a clock that the caller has read; nothing here reads one.

use crate::role::Role;

pub const NS_PER_S: u64 = 1_000_000_000;

/// The grid of a run: tick k begins at t_k = t_0 + k T.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// Begin of tick 0 on CLOCK_MONOTONIC [ns].
    pub t0_ns: u64,
    /// Length of a tick on the clock [ns].
    pub period_ns: u64,
}

impl Grid {
    /// When a tick begins [ns]; the end of time where it is further than that.
    pub const fn begin_of(&self, tick: u64) -> u64 {
        self.t0_ns
            .saturating_add(tick.saturating_mul(self.period_ns))
    }

    /// When a stage waits no longer for its input of a tick of which it leaves the plant so much for its lead [ns].
    pub const fn cut_off_of(&self, stage: Role, tick: u64, lead_ns: u64) -> u64 {
        let usable_ns = self.period_ns.saturating_sub(lead_ns);
        self.begin_of(tick)
            .saturating_add(usable_ns * stage.deadline_percent() / 100)
    }

    /// The tick that an instant lies in; 0 before the first has begun.
    pub const fn tick_at(&self, instant_ns: u64) -> u64 {
        instant_ns.saturating_sub(self.t0_ns) / self.period_ns
    }

    /// The first tick that begins at or after an instant.
    pub const fn first_tick_from(&self, instant_ns: u64) -> u64 {
        instant_ns
            .saturating_sub(self.t0_ns)
            .div_ceil(self.period_ns)
    }
}

/// What moves the ticks of a run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// The clock: tick k begins at its place on the grid, whether or not the stages are ready.
    Realtime(Grid),
    /// The chain itself: a tick begins when the command of the one before has arrived.
    Lockstep,
}

impl Pace {
    /// The latest tick whose messages may be there at an instant.
    ///
    /// On the grid it is the next one: it may begin between a look at the clock and one at a port.
    pub const fn newest_tick(&self, instant_ns: u64) -> u64 {
        match self {
            Self::Realtime(grid) => grid.tick_at(instant_ns) + 1,
            Self::Lockstep => u64::MAX - 1,
        }
    }

    /// The tick from which a command of `tick`, published at `send_ns`, is in force at the earliest.
    pub const fn effective_tick(&self, tick: u64, send_ns: u64) -> u64 {
        match self {
            Self::Realtime(grid) => {
                let arrived = grid.first_tick_from(send_ns);
                if arrived > tick + 1 {
                    arrived
                } else {
                    tick + 1
                }
            }
            Self::Lockstep => tick + 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_and_instants_agree() {
        let grid = Grid {
            t0_ns: 5_000,
            period_ns: 1_000,
        };
        assert_eq!(grid.begin_of(3), 8_000);
        assert_eq!([8_000, 7_999, 1].map(|ns| grid.tick_at(ns)), [3, 2, 0]);
        let first_ticks = [8_000, 8_001, 1].map(|ns| grid.first_tick_from(ns));
        assert_eq!(first_ticks, [3, 4, 0]);
    }
}
