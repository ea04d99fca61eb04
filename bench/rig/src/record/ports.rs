//! Ports of the loop's topics: the recorder's, its relays, an observer's; and when the recorder drains them.

use std::thread::sleep;
use std::time::Duration;

use model::boards::Run;
use model::grid::{Grid, Pace};
use model::inspection::{Expected, Rejections};
use model::messages::{NO_TICK, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;
use wire::clock::{Horizon, now_ns, sleep_until};
use wire::error::Error;
use wire::{DEEP, Receiver, Relay, Wire};

/// How often the topics are drained: far less than the receivers' depth takes to fill.
pub const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// Share of a tick, in percent, after which its loops are done for certain where nothing is wrong.
const LOOPS_DONE_PERCENT: u64 = 15;

/// Ports to receive every topic of the loop by.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Ports {
    /// Topic `state`.
    pub states: Receiver<State>,
    /// Topic `setpoint`.
    pub setpoints: Receiver<Setpoint>,
    /// Topic `wrench`.
    pub wrenches: Receiver<Wrench>,
    /// Topic `rotor_speeds`.
    pub rotor_speeds: Receiver<RotorSpeeds>,
    /// Topic `swaps`.
    pub swaps: Receiver<SwapRecord>,
}

impl Ports {
    /// The recorder's, deep enough for its longest absence.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.receiver(DEEP)?,
            setpoints: wire.receiver(DEEP)?,
            wrenches: wire.receiver(DEEP)?,
            rotor_speeds: wire.receiver(DEEP)?,
            swaps: wire.receiver(DEEP)?,
        })
    }

    /// An observer's, which the recorder passes messages on to.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn observing(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.observer()?,
            setpoints: wire.observer()?,
            wrenches: wire.observer()?,
            rotor_speeds: wire.observer()?,
            swaps: wire.observer()?,
        })
    }

    /// Connects them for a run.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.states.arm(expected)?;
        self.setpoints.arm(expected)?;
        self.wrenches.arm(expected)?;
        self.rotor_speeds.arm(expected)?;
        self.swaps.arm(expected)
    }

    /// Messages that did not pass inspection.
    #[must_use]
    pub fn rejections(&self) -> Rejections {
        self.states
            .rejections()
            .and(self.setpoints.rejections())
            .and(self.wrenches.rejections())
            .and(self.rotor_speeds.rejections())
            .and(self.swaps.rejections())
    }
}

/// Ports to pass every topic on by, and what the recorder says itself.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Relays {
    /// Topic `state`.
    pub states: Relay<State>,
    /// Topic `setpoint`.
    pub setpoints: Relay<Setpoint>,
    /// Topic `wrench`.
    pub wrenches: Relay<Wrench>,
    /// Topic `rotor_speeds`.
    pub rotor_speeds: Relay<RotorSpeeds>,
    /// Topic `swaps`.
    pub swaps: Relay<SwapRecord>,
    /// Topic `theorem`.
    pub theorem: Relay<Monitor>,
}

impl Relays {
    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.relay()?,
            setpoints: wire.relay()?,
            wrenches: wire.relay()?,
            rotor_speeds: wire.relay()?,
            swaps: wire.relay()?,
            theorem: wire.relay()?,
        })
    }
}

/// Which ticks messages can be of, for whoever flies with nobody: by the clock, as for the stages.
///
/// Lockstep has no clock. The plant shows each tick on its board when its state is out, so that messages are of the
/// next tick at the latest.
pub fn horizon(pace: Pace, run: impl Fn() -> Run + Copy) -> impl Horizon {
    move || match pace {
        Pace::Realtime(_) => pace.latest_tick(),
        Pace::Lockstep => match run().tick {
            NO_TICK => 0,
            shown => shown + 1,
        },
    }
}

/// Sleeps until the topics are to be drained again: by the clock, when the loops of a tick are done, so that the
/// recorder works while they rest. The caches are theirs otherwise, and the processor may be one half of a core.
pub fn rest(pace: Pace) {
    match pace {
        // A signal only has it drain early.
        Pace::Realtime(grid) => {
            sleep_until(next_drain(grid, now_ns()));
        }
        Pace::Lockstep => sleep(DRAIN_EVERY),
    }
}

/// When to drain after `now` [ns].
fn next_drain(grid: Grid, now: u64) -> u64 {
    let due = now + DRAIN_EVERY.as_nanos() as u64;
    let between = grid.begin_of(grid.tick_at(due)) + grid.period_ns * LOOPS_DONE_PERCENT / 100;
    // Where a tick takes longer than the time between two drains, some come later in it.
    if between > now { between } else { due }
}

/// Keeps the first error of some.
pub(super) fn keep_first<E>(kept: &mut Result<(), E>, next: Result<(), E>) {
    if kept.is_ok() {
        *kept = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_lockstep_messages_are_of_the_tick_after_the_one_on_the_board_at_the_latest() {
        let latest = |tick| horizon(Pace::Lockstep, || Run { tick, ..Run::default() }).latest_tick();
        assert_eq!([NO_TICK, 0, 41].map(latest), [0, 1, 42]);
    }

    #[test]
    fn topics_are_drained_about_every_10_ms_when_the_loops_are_done() {
        let ms = |ms: f64| (ms * 1e6).round() as u64;
        let at = |period: f64, now: f64| next_drain(Grid { t0_ns: ms(100.0), period_ns: ms(period) }, ms(now));
        assert_eq!(at(1.0, 100.15), ms(110.15));
        assert_eq!(at(1.0, 100.90), ms(110.15), "it took its time");
        assert_eq!(at(1.0, 20.0), ms(100.15), "before the first tick there is nothing to drain");
        // In slow motion: never at once, and at the beginning of no tick.
        assert_eq!(at(20.0, 103.0), ms(113.0));
        assert_eq!(at(20.0, 113.0), ms(123.0));
        assert_eq!(at(20.0, 100.0), ms(103.0));
    }
}
