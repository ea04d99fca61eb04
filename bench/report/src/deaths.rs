//! Processes that ended in flight: who, when, how, and what it cost.

use std::fmt::Write as _;

use model::boards::Arrival;
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
    /// From the beginning of its last tick until the launcher noticed [ms]: a launcher is woken by a death.
    pub noticed_after_ms: Option<f64>,
    /// From its last message to the first one of its successor [ms]; none where there was none.
    pub back_after_ms: Option<f64>,
    /// Ticks of which the role sent no message, up to its successor's first or to the end of the flight.
    pub ticks_lost: Option<u64>,
    /// Of a successor that sent no message: tick of the death that it was to make good, whose ticks its own are.
    #[serde(default)]
    pub within: Option<u64>,
    /// What that time is made of, where a launcher saw it.
    #[serde(default)]
    pub back_parts: Option<BackParts>,
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
    /// How its successor came, where it has one.
    pub way: Way,
}

/// How a successor came, as its launcher saw it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Way {
    /// Process number; 0 where there is none.
    pub pid: u32,
    /// Whether it was a spare that waited.
    pub is_spare: bool,
    /// When what the dead one had left was removed [ns].
    pub cleaned_ns: u64,
    /// What it says itself.
    pub arrival: Arrival,
}

/// What the time is made of in which a stage came back, each part after the one before it [ms].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BackParts {
    /// Whether a spare had waited for it.
    pub spare: bool,
    /// Until the launcher noticed, as `noticed_after_ms`.
    pub noticed_ms: f64,
    /// The launcher removed what the dead process had left in shared memory.
    pub cleaned_ms: f64,
    /// The launcher waited until it was due, and the successor ran: a process that was started, or a spare that woke.
    pub begun_ms: f64,
    /// It had its settings and its law.
    pub made_ms: f64,
    /// It had its place: the role's lock, a node of the middleware, its status board.
    pub placed_ms: f64,
    /// It had its ports.
    pub ported_ms: f64,
    /// It had its real-time set-up.
    pub engaged_ms: f64,
    /// It had found the run, and connected its ports.
    pub armed_ms: f64,
    /// The tick of its first message began.
    pub first_tick_ms: f64,
}

impl Way {
    /// The parts, up to the beginning of a tick, for a process that had sent its last message in another one; nothing
    /// where the successor did not get to fly.
    fn parts(&self, noticed_ns: u64, last_tick_ns: u64, first_tick_ns: u64) -> Option<BackParts> {
        let Self { arrival: Arrival { begun_ns, made_ns, placed_ns, ported_ns, engaged_ns, armed_ns }, .. } = *self;
        let ms = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
        (armed_ns > 0).then(|| BackParts {
            spare: self.is_spare,
            noticed_ms: ms(last_tick_ns, noticed_ns),
            cleaned_ms: ms(noticed_ns, self.cleaned_ns),
            begun_ms: ms(self.cleaned_ns, begun_ns),
            made_ms: ms(begun_ns, made_ns),
            placed_ms: ms(made_ns, placed_ns),
            ported_ms: ms(placed_ns, ported_ns),
            engaged_ms: ms(ported_ns, engaged_ns),
            armed_ms: ms(engaged_ns, armed_ns),
            first_tick_ms: ms(armed_ns, first_tick_ns),
        })
    }
}

/// Puts in what the launcher saw: how each process ended, and deaths that no message tells of.
pub fn note(report: &mut Report, noted: &[Noted], grid: &Grid) {
    let period_s = report.run.period_us / 1e6;
    for Noted { role, epoch, how, noticed_ns, way } in noted {
        let is_it = |death: &&mut Death| death.role == *role && death.epoch == *epoch && *epoch != 0;
        if let Some(death) = report.deaths.iter_mut().find(is_it) {
            let since_ns = noticed_ns.saturating_sub(grid.begin_of(death.tick));
            (death.how, death.noticed_after_ms) = (how.clone(), Some(since_ns as f64 / 1e6));
            let first_tick_ns = death.ticks_lost.map(|lost| grid.begin_of(death.tick + lost + 1));
            let first_tick_ns = first_tick_ns.filter(|_| death.back_after_ms.is_some());
            let last_tick_ns = grid.begin_of(death.tick);
            death.back_parts = first_tick_ns.and_then(|first| way.parts(*noticed_ns, last_tick_ns, first));
            continue;
        }
        let tick = grid.tick_at(*noticed_ns);
        let within =
            report.deaths.iter().find(|death| death.role == *role && death.covers(tick)).map(|death| death.tick);
        let (role, how, time_s) = (role.clone(), how.clone(), tick as f64 * period_s);
        report.deaths.push(Death { role, tick, time_s, how, within, ..Death::default() });
    }
    report.deaths.sort_by_key(|death| death.tick);
}

impl Death {
    /// Whether a tick is one that the role lost with it.
    fn covers(&self, tick: u64) -> bool {
        self.ticks_lost.is_some_and(|lost| (self.tick..=self.tick + lost).contains(&tick))
    }

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
        line.extend(
            self.within.map(|tick| format!(", before its first message: its ticks are those lost at tick {tick}")),
        );
        line.extend(self.ticks_lost.map(|ticks| format!(", {} lost", count(ticks, "tick"))));
        // Where the flight ended with it, nothing was seen of what it cost.
        let cost_m = self.position_error_max_m.filter(|_| self.back_after_ms.is_some());
        line.extend(cost_m.map(|m| format!(", position error up to {m:.4} m within {COST_S} s")));
        line
    }
}

impl BackParts {
    /// The parts in their order, each with what it is called [ms].
    #[must_use]
    pub const fn named(&self) -> [(&'static str, f64); 9] {
        [
            ("noticed", self.noticed_ms),
            ("cleaned up", self.cleaned_ms),
            (if self.spare { "woken" } else { "started" }, self.begun_ms),
            ("settings and law", self.made_ms),
            ("place", self.placed_ms),
            ("ports", self.ported_ms),
            ("real time", self.engaged_ms),
            ("joined", self.armed_ms),
            ("first tick", self.first_tick_ms),
        ]
    }

    /// All of them [ms].
    #[must_use]
    pub fn sum_ms(&self) -> f64 {
        self.named().iter().map(|(_, ms)| ms).sum()
    }

    /// The parts in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let parts = self.named().map(|(part, ms)| format!("{part} {ms:.2}")).join(", ");
        format!("{} [ms]: {parts}", if self.spare { "a spare" } else { "a new process" })
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
    let parts =
        |death: &Death| death.back_parts.as_ref().map_or_else(String::new, |parts| format!("    {}\n", parts.line()));
    let lines = report.deaths.iter().map(|death| format!("  {}\n{}", death.line(), parts(death)));
    let left_out = match report.deaths_left_out {
        0 => String::new(),
        more => format!("  and {more} later ones\n"),
    };
    format!("Deaths    {}\n{}{left_out}", number(report), lines.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_of_a_return_are_its_whole_time() {
        let ms = |ms: u64| ms * 1_000_000;
        let arrival = Arrival {
            begun_ns: ms(107),
            made_ns: ms(111),
            placed_ns: ms(116),
            ported_ns: ms(122),
            engaged_ns: ms(129),
            armed_ns: ms(137),
        };
        let way = Way { pid: 7, is_spare: true, cleaned_ns: ms(104), arrival };
        let parts = way.parts(ms(102), ms(100), ms(146)).unwrap();
        assert_eq!(parts.named().map(|(_, ms)| ms), [2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
        assert_eq!(parts.sum_ms(), 46.0);
        assert!(parts.line().starts_with("a spare [ms]: noticed 2.00, cleaned up 2.00, woken 3.00, settings"));
        let fresh = BackParts { spare: false, ..parts };
        assert!(fresh.line().starts_with("a new process [ms]: noticed 2.00, cleaned up 2.00, started 3.00"));
        let landed = Way { arrival: Arrival { armed_ns: 0, ..arrival }, ..way };
        assert_eq!(landed.parts(ms(102), ms(100), ms(146)), None, "it did not get to fly");
    }
}
