//! Outages as text: the causes of missed deadlines, and each of the worst outages with its timeline.

use crate::miss_causes::MissCause;
use crate::outages::{
    CauseCount, OutageCase, OutageSection, TimelineStage, TimelineTick, WORST_SHOWN,
};
use crate::phrase::count;

impl OutageSection {
    /// The section of the report for people; empty where nothing was out.
    #[must_use]
    pub fn text(&self) -> String {
        if self.classes.is_empty() && self.pending == 0 {
            return String::new();
        }
        let mut out = String::from("\nOutages   missed  cause\n");
        for count in &self.classes {
            out += &format!(
                "  {:>7} {:>7}  {}\n",
                count.outages,
                count.missed,
                count.cause()
            );
        }
        if self.pending > 0 {
            out += &format!("  {:>7} {:>7}  not classified yet\n", "-", self.pending);
        }
        for case in self.worst.iter().take(WORST_SHOWN) {
            out += &case.text();
        }
        if !self.worst.is_empty() {
            out += "  woke .. sent [us], from the beginning of the outage's first tick; * without the input of its tick\n";
        }
        out
    }
}

impl CauseCount {
    #[must_use]
    pub fn cause(&self) -> String {
        named(self.class, self.stage.as_deref())
    }
}

/// A class with the stage that it is due to.
fn named(class: MissCause, stage: Option<&str>) -> String {
    stage.map_or_else(
        || class.words().to_owned(),
        |stage| format!("{}, {stage}", class.words()),
    )
}

impl OutageCase {
    /// Where, how long and why, in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let Self {
            tick,
            time_s,
            ticks,
            missed,
            delay_us,
            ..
        } = self;
        let ticks = count(*ticks, "tick");
        let cause = named(self.class, self.stage.as_deref());
        // Where no stage is known to be late, there is no delay.
        let delay = if *delay_us > 0.0 {
            format!(", a delay of {delay_us:.0} us")
        } else {
            String::new()
        };
        let faults = if self.faults.is_empty() {
            String::new()
        } else {
            format!("; fault on: {}", self.faults.join(", "))
        };
        format!(
            "tick {tick} ({time_s:.3} s): {ticks}, {missed} missed{delay}: {cause} ({}{faults})",
            self.evidence
        )
    }

    fn text(&self) -> String {
        let mut out = format!("  {}\n", self.line());
        let mut next = self.timeline.first().map_or(0, |first| first.tick);
        for TimelineTick { tick, stages, .. } in &self.timeline {
            if *tick > next {
                out += "    ...\n";
            }
            next = tick.saturating_add(1);
            let stages: Vec<String> = stages.iter().map(TimelineStage::text).collect();
            let stages = if stages.is_empty() {
                "no stage published".into()
            } else {
                stages.join("  ")
            };
            out += &format!(
                "    {:>+3}  {stages}\n",
                tick.cast_signed() - self.tick.cast_signed()
            );
        }
        out
    }
}

impl TimelineStage {
    fn text(&self) -> String {
        let stale = if self.is_fresh { "" } else { "*" };
        format!(
            "{}{stale} {:.0} .. {:.0}",
            self.role, self.wake_us, self.send_us
        )
    }
}
