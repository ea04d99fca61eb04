//! The ports through which the recorder and observers receive every topic, and when the recorder drains them.

use std::thread::sleep;
use std::time::Duration;

use flight_log::entry::LogEntry;
use ipc::clock::{Horizon, now_ns, sleep_until};
use ipc::error::Error;
use ipc::{Receiver, Relay, Wire};
use messages::blackboards::Run;
use messages::content::{
    Decisions, Loss, NO_TICK, RotorSpeeds, Setpoint, State, SwapRecord, Wrench,
};
use messages::grid::{Grid, Pace};
use messages::inspection::{Expected, Rejections};
use messages::monitor::Monitor;
use messages::role::Channel;

/// How often the topics are drained: far more often than the receivers' queues fill up.
pub const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// Share of a tick after which its stages have normally finished [%].
const LOOPS_DONE_PERCENT: u64 = 15;

/// Defines receivers of topics, which are listed in the order of the data flow.
macro_rules! receivers {
    ($(#[$meta:meta])* $ports:ident { $($topic:ident: $entry:ident($content:ty)),+ $(,)? }) => {
        $(#[$meta])*
        pub struct $ports {
            $($topic: Receiver<$content>,)+
        }

        impl $ports {
            /// The recorder's ports of a channel, with queues deep enough for its longest pause.
            pub fn new(wire: &Wire, channel: Channel) -> Result<Self, Error> {
                Ok(Self {
                    $($topic: wire.recorder_of(channel)?,)+
                })
            }

            pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
                $(self.$topic.arm(expected)?;)+
                Ok(())
            }

            /// Takes every message that has arrived, topic by topic.
            pub fn drain(
                &mut self,
                horizon: impl Horizon,
                mut take: impl FnMut(&LogEntry),
            ) -> Result<(), Error> {
                $(self.$topic.drain(horizon, |it| take(&LogEntry::$entry(*it)))?;)+
                Ok(())
            }

            /// Messages that did not pass inspection.
            pub fn rejections(&self) -> Rejections {
                Rejections::default()$(.and(self.$topic.rejections()))+
            }
        }
    };
}

receivers! {
    /// What a further channel sends.
    ChannelPorts {
        setpoints: Setpoint(Setpoint),
        wrenches: Wrench(Wrench),
        rotor_speeds: RotorSpeeds(RotorSpeeds),
    }
}

macro_rules! ports {
    ($($topic:ident: $entry:ident($content:ty)),+ $(,)?) => {
        receivers! {
            Ports { $($topic: $entry($content)),+ }
        }

        impl Ports {
            /// An observer's ports, to which the recorder passes messages on.
            pub fn observing(wire: &Wire) -> Result<Self, Error> {
                Ok(Self {
                    $($topic: wire.observer()?,)+
                })
            }
        }

        /// Ports through which the recorder passes every topic on to observers, and publishes the monitor's results.
        pub struct Relays {
            $($topic: Relay<$content>,)+
            theorem: Relay<Monitor>,
            losses: Relay<Loss>,
        }

        impl Relays {
            pub fn new(wire: &Wire) -> Result<Self, Error> {
                Ok(Self {
                    $($topic: wire.relay()?,)+
                    theorem: wire.relay()?,
                    losses: wire.relay()?,
                })
            }

            pub fn pass_on(&mut self, entry: &LogEntry) -> Result<(), Error> {
                match entry {
                    $(LogEntry::$entry(message) => self.$topic.pass_on(message),)+
                    LogEntry::Theorem(message) => self.theorem.pass_on(message),
                    LogEntry::Loss(message) => self.losses.pass_on(message),
                }
            }
        }
    };
}

ports! {
    states: State(State),
    setpoints: Setpoint(Setpoint),
    wrenches: Wrench(Wrench),
    rotor_speeds: RotorSpeeds(RotorSpeeds),
    swaps: Swap(SwapRecord),
    decisions: Decisions(Decisions),
}

/// The latest tick that a message can belong to: by the clock, as for the stages.
///
/// Lockstep has no clock. The plant publishes each tick after its state, so the latest possible tick is the next one.
pub fn horizon(pace: Pace, run: impl Fn() -> Run + Copy) -> impl Horizon {
    move || match pace {
        Pace::Realtime(_) => pace.latest_tick(),
        Pace::Lockstep => match run().tick {
            NO_TICK => 0,
            shown => shown + 1,
        },
    }
}

/// Sleeps until the next drain. In real time that is when the stages of a tick have finished: the recorder shares
/// caches, and perhaps a core, with them, so it works while they wait.
pub fn rest(pace: Pace) {
    match pace {
        // A signal only causes an early drain.
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
    // If a tick is longer than the interval between drains, some drains come later within the tick.
    if between > now { between } else { due }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_lockstep_messages_are_of_the_tick_after_the_one_on_the_board_at_the_latest() {
        let latest = |tick| {
            horizon(Pace::Lockstep, || Run {
                tick,
                ..Run::default()
            })
            .latest_tick()
        };
        assert_eq!([NO_TICK, 0, 41].map(latest), [0, 1, 42]);
    }

    #[test]
    fn topics_are_drained_about_every_10_ms_when_the_loops_are_done() {
        let ns = |ms: f64| (ms * 1e6).round() as u64;
        for (period_ms, now_ms, expected_ms) in [
            (1.0, 100.15, 110.15),
            // It took its time.
            (1.0, 100.90, 110.15),
            // Before the first tick there is nothing to drain.
            (1.0, 20.0, 100.15),
            // In slow motion: never at once, and at the beginning of no tick.
            (20.0, 103.0, 113.0),
            (20.0, 113.0, 123.0),
            (20.0, 100.0, 103.0),
        ] {
            let grid = Grid {
                t0_ns: ns(100.0),
                period_ns: ns(period_ms),
            };
            assert_eq!(next_drain(grid, ns(now_ms)), ns(expected_ms), "{now_ms}");
        }
    }
}
