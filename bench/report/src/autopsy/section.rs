//! What the report says of outages.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::autopsy::classes::Class;
use crate::autopsy::runners::RunnerTime;
use crate::injected::InjectedFault;
use crate::text::count;

/// Outages in the text and on the page; report.json has more.
pub const WORST_SHOWN: usize = 10;

/// The autopsy in the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// How many outages each class has, by the stage that they were due to; the one with the most misses first.
    pub classes: Vec<ClassCount>,
    /// Deadlines missed in an outage that lasts, or is not classed yet.
    pub pending: u64,
    /// The longest row of ticks without an output in time, of each stage that had one, and of all stages at once
    /// ([`MACHINE`](crate::margin::line::MACHINE)); none in reports from before it was counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest: Option<BTreeMap<String, u64>>,
    /// Outages with missed deadlines that count in no such row: messages were lost there, so who was out is not known.
    #[serde(default)]
    pub unmeasured: u64,
    /// The longest outages in ticks; of those alike, the ones with more deadlines missed first.
    pub worst: Vec<Case>,
}

/// Outages of a class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassCount {
    /// The class.
    pub class: Class,
    /// The stage that they were due to; none where it was none, or is not known.
    pub stage: Option<String>,
    /// Outages.
    pub outages: u64,
    /// Deadlines missed in them.
    pub missed: u64,
}

/// An outage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Its first tick.
    pub tick: u64,
    /// Begin of that tick as time of the flight on the clock [s].
    pub time_s: f64,
    /// How many ticks were out.
    pub ticks: u64,
    /// How many of their commands missed the deadline.
    pub missed: u64,
    /// From the instant when the late stage was due to its next sign of life [us]; 0 where no stage is known.
    pub delay_us: f64,
    /// That instant, from the beginning of the first tick on [us].
    pub due_us: f64,
    /// Why.
    pub class: Class,
    /// The stage that it was due to.
    pub stage: Option<String>,
    /// The evidence in words.
    pub evidence: String,
    /// Who had the loops' processor in the delay, the longest first; empty without a trace.
    #[serde(default)]
    pub ran: Vec<RunnerTime>,
    /// Faults of messages, stages and the processor that were on in it, or struck just before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<String>,
    /// What the stages did around its first tick and its last one; ticks between these are left out.
    pub timeline: Vec<TimelineTick>,
}

/// What the stages did in a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimelineTick {
    /// The tick.
    pub tick: u64,
    /// Whether its command missed the deadline, by the plant's verdict.
    #[serde(default)]
    pub missed: bool,
    /// Plant, outer, inner, mixer; those that published something.
    pub stages: Vec<TimelineStage>,
}

/// What a stage did in a tick; times from the beginning of the outage's first tick on [us].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimelineStage {
    /// The stage.
    pub role: String,
    /// When it woke, and had its input.
    pub wake_us: f64,
    /// When its output was published.
    pub send_us: f64,
    /// Its driving input was of the tick; otherwise it had waited until its cut-off.
    pub is_fresh: bool,
}

impl Section {
    /// The same, and each outage with the faults that were on.
    #[must_use]
    pub fn struck_by(mut self, faults: &[InjectedFault]) -> Self {
        for case in &mut self.worst {
            let strikes = |fault: &&InjectedFault| fault.strikes(case.tick, case.tick + case.ticks - 1);
            case.faults = faults.iter().filter(strikes).map(|fault| fault.what.clone()).collect();
        }
        self
    }

    /// The section of the report for people; empty where nothing was out.
    #[must_use]
    pub fn text(&self) -> String {
        if self.classes.is_empty() && self.pending == 0 {
            return String::new();
        }
        let mut out = String::from("\nOutages   missed  cause\n");
        for count in &self.classes {
            out += &format!("  {:>7} {:>7}  {}\n", count.outages, count.missed, count.cause());
        }
        if self.pending > 0 {
            out += &format!("  {:>7} {:>7}  not classed yet\n", "-", self.pending);
        }
        for case in self.worst.iter().take(WORST_SHOWN) {
            out += &case.text();
        }
        if !self.worst.is_empty() {
            out +=
                "  woke .. sent [us], from the beginning of the outage's first tick; * without the input of its tick\n";
        }
        out
    }
}

impl ClassCount {
    /// The class, with its stage.
    #[must_use]
    pub fn cause(&self) -> String {
        named(self.class, self.stage.as_deref())
    }
}

/// A class with the stage that it is due to.
fn named(class: Class, stage: Option<&str>) -> String {
    stage.map_or_else(|| class.words().to_owned(), |stage| format!("{}, {stage}", class.words()))
}

impl Case {
    /// Where, how long and why, in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let Self { tick, time_s, ticks, missed, delay_us, .. } = self;
        let ticks = count(*ticks, "tick");
        let cause = named(self.class, self.stage.as_deref());
        // Where no stage is known to be late, there is no delay.
        let delay = if *delay_us > 0.0 { format!(", a delay of {delay_us:.0} us") } else { String::new() };
        let faults =
            if self.faults.is_empty() { String::new() } else { format!("; fault on: {}", self.faults.join(", ")) };
        format!("tick {tick} ({time_s:.3} s): {ticks}, {missed} missed{delay}: {cause} ({}{faults})", self.evidence)
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
            let stages = if stages.is_empty() { "nobody published".into() } else { stages.join("  ") };
            out += &format!("    {:>+3}  {stages}\n", tick.cast_signed() - self.tick.cast_signed());
        }
        out
    }
}

impl TimelineStage {
    fn text(&self) -> String {
        let stale = if self.is_fresh { "" } else { "*" };
        format!("{}{stale} {:.0} .. {:.0}", self.role, self.wake_us, self.send_us)
    }
}
