//! The dashboard without a terminal: one line per second.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::output::{print, say};
use crate::watch::dashboard_model::{Model, WatchedFlight};
use crate::watch::feed::Feed;
use errors::{Failure, INTERRUPTED, OK};
use report::series::{Series, Statistics};

/// How often the feed is drained.
const LOOK_EVERY: Duration = Duration::from_millis(10);
const PRINT_EVERY: Duration = Duration::from_secs(1);

/// Prints lines until the flight ends.
pub fn run(model: &mut Model, feed: &mut Feed, stop: &AtomicBool) -> Result<u8, Failure> {
    say(&format!(
        "waiting for instance `{}` to fly (ironbird fly)\n",
        model.instance
    ));
    let mut next = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        feed.look(model)?;
        if let Some(flight) = &model.flight {
            if let Some(ending) = flight.ending {
                print(&format!("{}   {}\n", line(flight), ending.name()))?;
                return Ok(OK);
            }
            if Instant::now() >= next && flight.rotor_speeds.is_some() {
                next = Instant::now() + PRINT_EVERY;
                print(&format!("{}\n", line(flight)))?;
            }
        }
        sleep(LOOK_EVERY);
    }
    Ok(INTERRUPTED)
}

/// The state of the flight in one line.
#[must_use]
pub fn line(flight: &WatchedFlight) -> String {
    let mut line = format!(
        "tick {}   {:.1} s",
        flight.tick(),
        flight.run.flight_time_s(flight.tick())
    );
    // Writing into a string cannot fail.
    let _ = write!(
        line,
        "   error {:.4} m",
        flight.tally.flight().position_error_final_m
    );
    if let Some(histogram) = flight
        .tally
        .series
        .flight(Series::Loop)
        .filter(|histogram| !histogram.is_empty())
    {
        let statistics = Statistics::of("loop", histogram);
        let _ = write!(
            line,
            "   loop p50 {:.1} p99 {:.1} us",
            statistics.p50_us, statistics.p99_us
        );
    }
    let _ = write!(line, "   missed {}", flight.run.deadlines_missed);
    if let Some(monitor) = &flight.monitor {
        let violations: u64 = monitor.violations.iter().sum();
        let _ = write!(
            line,
            "   V {:.3e} rad^2/s^2   violations {violations} ({} unexplained)",
            monitor.v, monitor.violations[0]
        );
    }
    if let Some(tick) = flight.lost_at() {
        let _ = write!(line, "   no recorder: as of tick {tick}, not watched since");
    }
    let lost = flight.lost();
    if lost > 0 {
        let _ = write!(line, "   not seen {lost} messages");
    }
    line
}
