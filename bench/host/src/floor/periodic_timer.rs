//! The grid of a measurement: wakes on an absolute timer and records the lateness.

use std::time::Duration;

use hdrhistogram::Histogram;
use ipc::clock::{now_ns, sleep_until};
use messages::grid::Grid;

use errors::Failure;
use report::series::histogram;

/// From the making of a periodic timer to its first tick [ns].
const BEGINS_NS: u64 = 2_000_000;

/// Wakes the calling thread tick after tick.
#[derive(Clone, Debug)]
pub struct PeriodicTimer {
    grid: Grid,
    next_tick: u64,
    ticks: u64,
    /// From the beginning of each tick to the waking [ns]; ticks slept through enter with their whole lateness.
    pub lateness: Histogram<u64>,
    pub skipped: u64,
}

impl PeriodicTimer {
    /// A periodic timer that begins in 2 ms and runs for `duration`; a tick takes `period_ns`.
    pub fn new(period_ns: u64, duration: Duration) -> Result<Self, Failure> {
        let ticks = duration
            .as_nanos()
            .checked_div(u128::from(period_ns))
            .unwrap_or(0);
        if ticks == 0 {
            return Err(Failure::usage(format!(
                "no tick of {period_ns} ns fits into {duration:?}"
            ))
            .help("measure for longer, as in --seconds 5"));
        }
        let mut lateness = histogram()?;
        // Writes its counts once, so that no page of them is missing when it matters.
        lateness.saturating_record(1);
        lateness.reset();
        let ticks = u64::try_from(ticks).unwrap_or(u64::MAX);
        let grid = Grid {
            t0_ns: now_ns() + BEGINS_NS,
            period_ns,
        };
        Ok(Self {
            grid,
            next_tick: 0,
            ticks,
            lateness,
            skipped: 0,
        })
    }

    /// Sleeps until the next tick; gives when the thread woke [ns], and nothing after the last tick.
    pub fn next_wake(&mut self) -> Option<u64> {
        self.next_wake_after(0, |_| ())
    }

    /// Sleeps until `lead_ns` before the next tick, acts, and reads the clock until the tick begins; gives when it had
    /// begun [ns], and nothing after the last tick. `act` is given the time that is left [ns], and is left out where
    /// there is none.
    pub fn next_wake_after(&mut self, lead_ns: u64, act: impl FnOnce(u64)) -> Option<u64> {
        if self.next_tick >= self.ticks {
            return None;
        }
        let begin_ns = self.grid.begin_of(self.next_tick);
        let mut woken_ns = now_ns();
        while woken_ns < begin_ns - lead_ns {
            sleep_until(begin_ns - lead_ns);
            woken_ns = now_ns();
        }
        if woken_ns < begin_ns {
            act(begin_ns - woken_ns);
        }
        while woken_ns < begin_ns {
            woken_ns = now_ns();
        }
        let current = self.grid.tick_at(woken_ns).min(self.ticks - 1);
        for owed in self.next_tick..=current {
            self.lateness
                .saturating_record(woken_ns - self.grid.begin_of(owed));
        }
        self.skipped += current - self.next_tick;
        self.next_tick = current + 1;
        Some(woken_ns)
    }

    /// Ticks that it was woken for.
    #[must_use]
    pub fn ticks_run(&self) -> u64 {
        self.next_tick - self.skipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tick_is_woken_for_or_counted_as_skipped_and_has_its_lateness() {
        let mut periodic_timer = PeriodicTimer::new(1_000_000, Duration::from_millis(30)).unwrap();
        let mut wakes = 0;
        while periodic_timer.next_wake().is_some() {
            wakes += 1;
            if wakes == 5 {
                std::thread::sleep(Duration::from_millis(4));
            }
        }
        assert_eq!(
            (
                periodic_timer.ticks_run(),
                periodic_timer.ticks_run() + periodic_timer.skipped
            ),
            (wakes, 30)
        );
        assert!(periodic_timer.skipped >= 3, "{periodic_timer:?}");
        assert_eq!(periodic_timer.lateness.len(), 30);
        assert!(
            periodic_timer.lateness.max() >= 3_000_000,
            "the whole lateness of a tick slept through"
        );
    }

    #[test]
    fn with_a_lead_it_acts_before_the_tick_and_never_begins_it_early() {
        let mut periodic_timer = PeriodicTimer::new(1_000_000, Duration::from_millis(20)).unwrap();
        let (mut acted, mut most_left_ns) = (0, 0);
        while let Some(woken_ns) = periodic_timer.next_wake_after(200_000, |left_ns| {
            acted += 1;
            most_left_ns = left_ns.max(most_left_ns);
        }) {
            assert!(woken_ns >= periodic_timer.grid.begin_of(periodic_timer.next_tick - 1));
        }
        assert!(
            (1..=20).contains(&acted) && (1..=200_000).contains(&most_left_ns),
            "{acted}, {most_left_ns}"
        );
        assert_eq!(periodic_timer.lateness.len(), 20);
    }

    #[test]
    fn a_duration_without_a_tick_is_refused() {
        let error = PeriodicTimer::new(1_000_000, Duration::from_micros(999)).unwrap_err();
        assert!(
            error.to_string().contains("no tick of 1000000 ns"),
            "{error}"
        );
    }
}
