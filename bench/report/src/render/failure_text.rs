//! Process failures as text: which process ended, when and how, and what the flight lost by it.

use crate::phrase::count;
use crate::process_failures::{COST_S, number};
use crate::schema::{ProcessFailure, RecoveryPhases, Report};
use std::fmt::Write as _;

impl ProcessFailure {
    /// Who, when and how, and what it cost, in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let Self {
            role, tick, time_s, ..
        } = self;
        let how = if self.how.is_empty() {
            "cause of the end unknown"
        } else {
            &self.how
        };
        let mut line = format!("{role} at tick {tick} ({time_s:.3} s): {how}");
        // Writing into a string cannot fail.
        let _ = self
            .noticed_after_ms
            .iter()
            .try_for_each(|ms| write!(line, ", noticed after {ms:.0} ms"));
        match (self.back_after_ms, self.ticks_lost) {
            (Some(ms), _) => line += &format!(", back after {ms:.0} ms"),
            (None, Some(_)) => line += ", not back",
            (None, None) => {}
        }
        line.extend(self.within.map(|tick| {
            format!(", before its first message: its ticks are those lost at tick {tick}")
        }));
        line.extend(
            self.ticks_lost
                .map(|ticks| format!(", {} lost", count(ticks, "tick"))),
        );
        // Where the flight ended with it, nothing was seen of what it cost.
        let cost_m = self
            .position_error_max_m
            .filter(|_| self.back_after_ms.is_some());
        line.extend(cost_m.map(|m| format!(", position error up to {m:.4} m within {COST_S} s")));
        line
    }
}

impl RecoveryPhases {
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

    #[must_use]
    pub fn line(&self) -> String {
        let parts = self
            .named()
            .map(|(part, ms)| format!("{part} {ms:.2}"))
            .join(", ");
        format!(
            "{} [ms]: {parts}",
            if self.spare {
                "a spare"
            } else {
                "a new process"
            }
        )
    }
}

/// The section of the report for people.
#[must_use]
pub fn text(report: &Report) -> String {
    if report.deaths.is_empty() {
        return "Deaths    none\n".into();
    }
    let parts = |death: &ProcessFailure| {
        death
            .back_parts
            .as_ref()
            .map_or_else(String::new, |parts| format!("    {}\n", parts.line()))
    };
    let lines = report
        .deaths
        .iter()
        .map(|death| format!("  {}\n{}", death.line(), parts(death)));
    let left_out = match report.deaths_left_out {
        0 => String::new(),
        more => format!("  and {more} later ones\n"),
    };
    format!(
        "Deaths    {}\n{}{left_out}",
        number(report),
        lines.collect::<String>()
    )
}
