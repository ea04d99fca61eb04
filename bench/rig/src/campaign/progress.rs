//! Says how far a campaign is, how fast it goes and how long it takes.

use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use crate::output::say;

/// What is said of a campaign while it flies.
#[derive(Debug)]
pub(super) struct Progress {
    /// Flights, by all arms, that are to be flown.
    total: u64,
    begun: Instant,
    told: Instant,
    is_terminal: bool,
    /// Whether a line waits to be written over.
    is_open: bool,
}

impl Progress {
    /// Of so many flights that are about to begin.
    pub fn new(total: u64) -> Self {
        let now = Instant::now();
        Self { total, begun: now, told: now, is_terminal: io::stderr().is_terminal(), is_open: false }
    }

    /// So many need not be flown.
    pub fn skip(&mut self, flights: u64) {
        self.total -= flights;
    }

    /// Tells how many have been flown, if it is time.
    pub fn look(&mut self, flown: u64) {
        let every = if self.is_terminal { Duration::from_millis(500) } else { Duration::from_secs(30) };
        if self.told.elapsed() < every {
            return;
        }
        self.told = Instant::now();
        let line = words(flown, self.total, self.begun.elapsed());
        if self.is_terminal {
            say(&format!("\r\x1b[K{line}"));
            self.is_open = true;
        } else {
            say(&format!("{line}\n"));
        }
    }

    /// Clears its line, so that something else can be said.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.is_open) {
            say("\r\x1b[K");
        }
    }

    /// Flights per second so far.
    pub fn rate(&self, flown: u64) -> f64 {
        flown as f64 / self.begun.elapsed().as_secs_f64().max(1e-9)
    }
}

/// How far it is.
fn words(flown: u64, total: u64, elapsed: Duration) -> String {
    let rate = flown as f64 / elapsed.as_secs_f64().max(1e-9);
    let left = (total.saturating_sub(flown)) as f64 / rate;
    format!("{flown} of {total} flights, {rate:.1} flights/s, {}", left_words(left))
}

/// A time that is left, as nobody needs it more exactly.
fn left_words(seconds: f64) -> String {
    match Duration::try_from_secs_f64(seconds.ceil()) {
        Ok(left) if seconds < 1e9 => format!("{} left", humantime::format_duration(left)),
        _ => "time left unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_time_left_are_told() {
        assert_eq!(words(200, 4000, Duration::from_secs(4)), "200 of 4000 flights, 50.0 flights/s, 1m 16s left");
        assert_eq!(words(0, 4000, Duration::from_secs(4)), "0 of 4000 flights, 0.0 flights/s, time left unknown");
    }
}
