//! Processes that ended in flight: who, when, how, and what it cost.

use std::fmt::Write as _;

use model::grid::Grid;
use serde::{Deserialize, Serialize};

use crate::schema::Report;
use crate::text::count;

/// How long after a death its cost is looked for [s].
pub const COST_S: f64 = 5.0;

/// The end of a process that the flight still needed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Death {
    /// Its role.
    pub role: String,
    /// Tick of its last message; of a process that sent none, the tick in which its end was noticed.
    pub tick: u64,
    /// The same as time of the flight [s].
    pub time_s: f64,
    /// When the process started, on `CLOCK_MONOTONIC` [ns]: the epoch of its messages. 0 where it sent none.
    pub epoch: u64,
    /// How it ended, as `signal: 9 (SIGKILL)`; empty where nobody waited for the process.
    pub how: String,
    /// From the beginning of its last tick until the launcher noticed [ms]: a launcher looks every 10 ms.
    pub noticed_after_ms: Option<f64>,
    /// From its last message to the first one of its successor [ms]; none where there was none.
    pub back_after_ms: Option<f64>,
    /// Ticks of which the role sent no message, up to its successor's first or to the end of the flight.
    pub ticks_lost: Option<u64>,
    /// Largest position error after its last message, within [`COST_S`] [m].
    pub position_error_max_m: Option<f64>,
}

/// What a launcher saw of a process that ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Noted {
    /// Its role.
    pub role: String,
    /// Epoch of its messages; 0 where it sent none.
    pub epoch: u64,
    /// How it ended.
    pub how: String,
    /// When the launcher noticed [ns].
    pub noticed_ns: u64,
}

/// Puts in what the launcher saw: how each process ended, and deaths that no message tells of.
pub fn note(report: &mut Report, noted: &[Noted], grid: &Grid) {
    let period_s = report.run.period_us / 1e6;
    for Noted { role, epoch, how, noticed_ns } in noted {
        let is_it = |death: &&mut Death| death.role == *role && death.epoch == *epoch && *epoch != 0;
        if let Some(death) = report.deaths.iter_mut().find(is_it) {
            let since_ns = noticed_ns.saturating_sub(grid.begin_of(death.tick));
            (death.how, death.noticed_after_ms) = (how.clone(), Some(since_ns as f64 / 1e6));
            continue;
        }
        let tick = grid.tick_at(*noticed_ns);
        let (role, how, time_s) = (role.clone(), how.clone(), tick as f64 * period_s);
        report.deaths.push(Death { role, tick, time_s, how, ..Death::default() });
    }
    report.deaths.sort_by_key(|death| death.tick);
}

impl Death {
    /// Who, when and how, and what it cost, in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let Self { role, tick, time_s, .. } = self;
        let how = if self.how.is_empty() { "nobody saw how" } else { &self.how };
        let mut line = format!("{role} at tick {tick} ({time_s:.3} s): {how}");
        // Writing into a string cannot fail.
        let _ = self.noticed_after_ms.iter().try_for_each(|ms| write!(line, ", noticed after {ms:.0} ms"));
        match (self.back_after_ms, self.ticks_lost) {
            (Some(ms), _) => line += &format!(", back after {ms:.0} ms"),
            (None, Some(_)) => line += ", not back",
            (None, None) => {}
        }
        line.extend(self.ticks_lost.map(|ticks| format!(", {} lost", count(ticks, "tick"))));
        // Where the flight ended with it, nothing was seen of what it cost.
        let cost_m = self.position_error_max_m.filter(|_| self.back_after_ms.is_some());
        line.extend(cost_m.map(|m| format!(", position error up to {m:.4} m within {COST_S} s")));
        line
    }
}

/// How many there were.
#[must_use]
pub const fn number(report: &Report) -> u64 {
    (report.deaths.len() as u64).saturating_add(report.deaths_left_out)
}

/// The section of the report for people.
#[must_use]
pub fn text(report: &Report) -> String {
    if report.deaths.is_empty() {
        return "Deaths    none\n".into();
    }
    let lines = report.deaths.iter().map(|death| format!("  {}\n", death.line()));
    let left_out = match report.deaths_left_out {
        0 => String::new(),
        more => format!("  and {more} later ones\n"),
    };
    format!("Deaths    {}\n{}{left_out}", number(report), lines.collect::<String>())
}
