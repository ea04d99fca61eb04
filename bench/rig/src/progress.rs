//! Prints the progress of long work: items done, rate and time left.

use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use crate::output::say;

#[derive(Debug)]
pub struct Progress {
    total: u64,
    thing: &'static str,
    begun: Instant,
    told: Instant,
    is_terminal: bool,
    /// Whether the terminal shows a line that the next one overwrites.
    is_open: bool,
}

impl Progress {
    /// For `total` items, each called `thing`, such as `flight`.
    #[must_use]
    pub fn new(total: u64, thing: &'static str) -> Self {
        let now = Instant::now();
        Self {
            total,
            thing,
            begun: now,
            told: now,
            is_terminal: io::stderr().is_terminal(),
            is_open: false,
        }
    }

    /// Removes items that need not be done.
    pub fn skip(&mut self, things: u64) {
        self.total -= things;
    }

    /// Prints how many items are done, at most every half second (30 s if not on a terminal).
    pub fn look(&mut self, done: u64) {
        let every = if self.is_terminal {
            Duration::from_millis(500)
        } else {
            Duration::from_secs(30)
        };
        if self.told.elapsed() < every {
            return;
        }
        self.told = Instant::now();
        let line = words(done, self.total, self.thing, self.begun.elapsed());
        if self.is_terminal {
            say(&format!("\r\x1b[K{line}"));
            self.is_open = true;
        } else {
            say(&format!("{line}\n"));
        }
    }

    /// Clears its line for other output.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.is_open) {
            say("\r\x1b[K");
        }
    }

    #[must_use]
    pub fn rate(&self, done: u64) -> f64 {
        done as f64 / self.begun.elapsed().as_secs_f64().max(1e-9)
    }
}

fn words(done: u64, total: u64, thing: &str, elapsed: Duration) -> String {
    let rate = done as f64 / elapsed.as_secs_f64().max(1e-9);
    let left = (total.saturating_sub(done)) as f64 / rate;
    format!(
        "{done} of {total} {thing}s, {rate:.1} {thing}s/s, {}",
        time_left(left)
    )
}

/// A time that is left, as nobody needs it more exactly.
fn time_left(seconds: f64) -> String {
    match Duration::try_from_secs_f64(seconds.ceil()) {
        Ok(left) if seconds < 1e9 => format!("{} left", humantime::format_duration(left)),
        _ => "time left unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_time_left_are_shown() {
        assert_eq!(
            words(200, 4000, "flight", Duration::from_secs(4)),
            "200 of 4000 flights, 50.0 flights/s, 1m 16s left"
        );
        assert_eq!(
            words(0, 4000, "flight", Duration::from_secs(4)),
            "0 of 4000 flights, 0.0 flights/s, time left unknown"
        );
    }
}
