//! Prints the progress of long work: items done, rate and time left.

use std::io;
use std::time::{Duration, Instant};

use errors::output::{has_screen, say};

#[derive(Debug)]
pub struct Progress {
    total: u64,
    thing: &'static str,
    begun: Instant,
    printed: Instant,
    is_terminal: bool,
    /// Whether the terminal shows a line that the next one overwrites.
    is_open: bool,
}

impl Progress {
    /// For `total` items, each called `thing`, such as `flight`.
    pub fn new(total: u64, thing: &'static str) -> Self {
        let now = Instant::now();
        Self {
            total,
            thing,
            begun: now,
            printed: now,
            is_terminal: has_screen(&io::stderr()),
            is_open: false,
        }
    }

    /// Removes items that need not be done.
    pub fn skip(&mut self, things: u64) {
        self.total -= things;
    }

    /// Prints how many items are done, at most every half second (30 s if not on a terminal).
    pub fn look(&mut self, done: u64) {
        let every_ms = if self.is_terminal { 500 } else { 30_000 };
        if self.printed.elapsed() < Duration::from_millis(every_ms) {
            return;
        }
        self.printed = Instant::now();
        let line = line(done, self.total, self.thing, self.rate(done));
        self.is_open = self.is_terminal;
        say(&match self.is_terminal {
            true => format!("\r\x1b[K{line}"),
            false => format!("{line}\n"),
        });
    }

    /// Clears its line for other output.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.is_open) {
            say("\r\x1b[K");
        }
    }

    pub fn rate(&self, done: u64) -> f64 {
        done as f64 / self.begun.elapsed().as_secs_f64().max(1e-9)
    }
}

fn line(done: u64, total: u64, thing: &str, rate: f64) -> String {
    let left_s = total.saturating_sub(done) as f64 / rate;
    let left = match Duration::try_from_secs_f64(left_s.ceil()) {
        Ok(left) if left_s < 1e9 => format!("{} left", humantime::format_duration(left)),
        _ => "time left unknown".into(),
    };
    // Items that take minutes have no rate per second.
    let rate = match rate < 0.1 && done > 0 {
        true => String::new(),
        false => format!(" {rate:.1} {thing}s/s,"),
    };
    format!("{done} of {total} {thing}s,{rate} {left}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_time_left_are_shown() {
        let unknown = "0 of 4000 flights, 0.0 flights/s, time left unknown";
        assert_eq!(line(0, 4000, "flight", 0.0), unknown);
        let left = "200 of 4000 flights, 50.0 flights/s, 1m 16s left";
        assert_eq!(line(200, 4000, "flight", 50.0), left);
        assert_eq!(line(2, 6, "pair", 0.033), "2 of 6 pairs, 2m 2s left");
    }
}
