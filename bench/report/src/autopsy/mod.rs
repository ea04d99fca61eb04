//! The autopsy of missed deadlines: which tick, how late, and why.
//!
//! It follows the stamps of every message and the plant's verdicts. It keeps [`WINDOW_TICKS`] around each miss until
//! they are complete, then has the miss classified ([`crate::autopsy::classes`]). The classes add up to the number of
//! missed deadlines.

pub mod classes;
pub mod evidence;

use std::collections::{BTreeMap, VecDeque};

use model::envelope::{Envelope, Message};
use model::grid::Grid;
use model::messages::State;
use model::role::{Role, STAGES};
use model::topic::Topic;
use serde::{Deserialize, Serialize};

use crate::autopsy::classes::{Class, Opinion, classify, index};
use crate::autopsy::evidence::{CounterSample, Life, Passage, Scene, TickPassages};

/// Ticks that are kept around a miss.
pub const WINDOW_TICKS: u64 = 64;
/// Misses of which the report shows the timeline.
const WORST: usize = 10;
/// Ticks before and after a miss in its timeline.
const TIMELINE: (u64, u64) = (1, 2);
/// Samples that are kept beyond those of the ticks [ns].
const SAMPLES_BEYOND_NS: u64 = 200_000_000;

/// The autopsy in the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// How many misses each class has, by the stage that they were due to; the most frequent first.
    pub classes: Vec<ClassCount>,
    /// Misses that wait for the ticks after them: not classed yet.
    pub pending: u64,
    /// The latest ones, each with those in a row after it; the latest first.
    pub worst: Vec<Case>,
}

/// Misses of a class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassCount {
    /// The class.
    pub class: Class,
    /// The stage that they were due to; none where it was none, or is not known.
    pub stage: Option<String>,
    /// Misses.
    pub count: u64,
}

/// A missed deadline, and those right after it that were missed for the same reason and less late.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Tick of the command that was missing when the next tick began.
    pub tick: u64,
    /// Begin of that tick as time of the flight on the clock [s].
    pub time_s: f64,
    /// Deadlines missed in a row for the same reason, this one the first.
    pub in_a_row: u64,
    /// How late the next command came [us].
    pub late_us: f64,
    /// Why.
    pub class: Class,
    /// The stage that it was due to.
    pub stage: Option<String>,
    /// The evidence in words.
    pub evidence: String,
    /// What the stages did around it.
    pub timeline: Vec<TimelineTick>,
}

/// What the stages did in a tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimelineTick {
    /// The tick.
    pub tick: u64,
    /// Plant, outer, inner, mixer; those that published something.
    pub stages: Vec<TimelineStage>,
}

/// What a stage did in a tick; times from the begin of the missed command's tick on [us].
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
    /// The section of the report for people; empty where nothing was missed.
    #[must_use]
    pub fn text(&self) -> String {
        if self.classes.is_empty() && self.pending == 0 {
            return String::new();
        }
        let mut out = String::from("\nAutopsy of missed deadlines\n");
        let due_to = |stage: &Option<String>| stage.as_ref().map_or_else(String::new, |stage| format!(", {stage}"));
        for ClassCount { class, stage, count } in &self.classes {
            out += &format!("  {count:>7}  {}{}\n", class.words(), due_to(stage));
        }
        if self.pending > 0 {
            out += &format!("  {:>7}  not classed yet\n", self.pending);
        }
        for case in &self.worst {
            out += &format!(
                "  tick {} ({:.3} s){} late by {:.1} us: {}{} ({})\n",
                case.tick,
                case.time_s,
                if case.in_a_row > 1 { format!(", the first of {},", case.in_a_row) } else { String::new() },
                case.late_us,
                case.class.words(),
                due_to(&case.stage),
                case.evidence
            );
            for TimelineTick { tick, stages } in &case.timeline {
                let stages: Vec<String> = stages.iter().map(TimelineStage::text).collect();
                let stages = if stages.is_empty() { "nobody published".into() } else { stages.join("  ") };
                out += &format!("    {:>+3}  {stages}\n", tick.cast_signed() - case.tick.cast_signed());
            }
        }
        if !self.worst.is_empty() {
            out += "  woke .. sent [us], from the beginning of the missed tick; * without the input of its tick\n";
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

/// Follows a flight.
#[derive(Clone, Debug)]
pub struct Autopsy {
    grid: Grid,
    /// A hypervisor runs below.
    is_virtual: bool,
    /// All loops have the same processor.
    share_processor: bool,
    traces: BTreeMap<u64, TickPassages>,
    samples: VecDeque<CounterSample>,
    /// Ticks that the plant's next states judged: from, to, missed deadlines among them, the last one's verdict.
    judged: Vec<Judged>,
    last_state: Option<(u64, u64)>,
    /// Ticks of commands that were missing, and not classed yet.
    pending: VecDeque<u64>,
    counts: BTreeMap<(Class, Option<Role>), u64>,
    worst: Vec<Case>,
    /// The row of misses that was classed last.
    row: Option<Row>,
}

/// Misses in a row for the same reason.
#[derive(Clone, Copy, Debug)]
struct Row {
    first_tick: u64,
    last_tick: u64,
    reason: (Class, Option<Role>),
}

#[derive(Clone, Copy, Debug)]
struct Judged {
    /// Ticks that the plant has judged: after this one ...
    after: Option<u64>,
    /// ... up to this one.
    tick: u64,
    /// How many of them missed.
    missed: u64,
    /// Whether the last one did; not known behind the last state.
    last_missed: Option<bool>,
}

impl Autopsy {
    /// Follows a flight on a grid.
    #[must_use]
    pub const fn new(grid: Grid, is_virtual: bool, share_processor: bool) -> Self {
        Self {
            grid,
            is_virtual,
            share_processor,
            traces: BTreeMap::new(),
            samples: VecDeque::new(),
            judged: Vec::new(),
            last_state: None,
            pending: VecDeque::new(),
            counts: BTreeMap::new(),
            worst: Vec::new(),
            row: None,
        }
    }

    /// Takes the stamps of a message.
    pub fn stamps<C: Topic>(&mut self, message: &Message<C>) {
        let (role, envelope) = (C::SENDER, &message.envelope);
        let stamps = envelope.stamps_of(role);
        let passage =
            Passage { receive_ns: stamps.receive_ns, send_ns: stamps.send_ns, is_fresh: is_fresh(role, envelope) };
        self.traces.entry(envelope.tick).or_default()[index(role)] = Some(passage);
    }

    /// Takes a state: its stamps, and the plant's verdicts since the one before.
    pub fn state(&mut self, message: &Message<State>) {
        self.stamps(message);
        let (tick, missed) = (message.envelope.tick, message.content.deadlines_missed);
        let (after, missed_before) = self.last_state.map_or((None, 0), |(tick, missed)| (Some(tick), missed));
        if missed > missed_before {
            let last_missed = Some(message.content.deadline_miss_run > 0);
            self.judged.push(Judged { after, tick, missed: missed - missed_before, last_missed });
        }
        self.last_state = Some((tick, missed));
    }

    /// Takes what the kernel has counted.
    pub fn sample(&mut self, sample: CounterSample) {
        self.samples.push_back(sample);
    }

    /// Takes which stages ended without landing, seen at an instant after the last sample: such an end ends the run,
    /// most often before the next sample would have shown it.
    pub fn fallen(&mut self, stages: [bool; STAGES.len()], at_ns: u64) {
        let mut sample = self.samples.back().copied().unwrap_or_default();
        sample.at_ns = at_ns;
        for (counters, _) in sample.stages.iter_mut().zip(stages).filter(|(_, fallen)| *fallen) {
            counters.life = Life::Dead;
        }
        self.samples.push_back(sample);
    }

    /// Classes the misses around which enough ticks have passed; to be called when the topics are drained.
    pub fn look(&mut self) {
        self.find();
        let newest = self.traces.last_key_value().map_or(0, |(tick, _)| *tick);
        while self.pending.front().is_some_and(|tick| tick + WINDOW_TICKS / 2 <= newest) {
            self.examine_next();
        }
        self.forget(newest);
    }

    /// Classes what is left, up to the last deadline missed: the flight is over.
    pub fn finish(&mut self, missed: u64, last_tick: u64) {
        let (after, missed_before) = self.last_state.map_or((None, 0), |(tick, missed)| (Some(tick), missed));
        if missed > missed_before {
            self.judged.push(Judged { after, tick: last_tick, missed: missed - missed_before, last_missed: None });
        }
        self.find();
        while !self.pending.is_empty() {
            self.examine_next();
        }
    }

    /// Finds the ticks of the misses: those whose command was not there when the next tick began.
    fn find(&mut self) {
        for Judged { after, tick, missed, last_missed } in std::mem::take(&mut self.judged) {
            let first = after.map_or(1, |after| after + 1);
            let mut misses: Vec<u64> = match last_missed {
                Some(true) => vec![tick],
                _ => Vec::new(),
            };
            let open_end = if last_missed.is_some() { tick } else { tick + 1 };
            // Of the ticks between two states the plant tells only how many missed; the stamps tell which.
            for skipped in (first..open_end).rev() {
                if misses.len() as u64 == missed {
                    break;
                }
                let sent_ns = self.traces.get(&(skipped - 1)).and_then(|trace| trace[Role::Mixer as usize]);
                if sent_ns.is_none_or(|passage| passage.send_ns > self.grid.begin_of(skipped)) {
                    misses.push(skipped);
                }
            }
            for _ in misses.len() as u64..missed {
                *self.counts.entry((Class::CannotTell, None)).or_default() += 1;
            }
            self.pending.extend(misses.into_iter().rev().map(|tick| tick - 1));
        }
    }

    fn examine_next(&mut self) {
        let Some(tick) = self.pending.pop_front() else { return };
        let (first, last) = (tick.saturating_sub(WINDOW_TICKS / 2), tick + WINDOW_TICKS / 2);
        let traces: BTreeMap<u64, TickPassages> =
            self.traces.range(first..last).map(|(tick, trace)| (*tick, *trace)).collect();
        let stamps = traces.values().flatten().flatten().map(|passage| passage.send_ns);
        let until_ns = stamps.max().unwrap_or(0).max(self.grid.begin_of(tick + 1));
        let opinion = classify(
            &Scene {
                grid: self.grid,
                traces: &traces,
                samples: self.samples.make_contiguous(),
                until_ns,
                is_virtual: self.is_virtual,
                share_processor: self.share_processor,
            },
            tick,
        );
        *self.counts.entry((opinion.class, opinion.stage)).or_default() += 1;
        let reason = (opinion.class, opinion.stage);
        let row = self.row.filter(|row| row.last_tick + 1 == tick && row.reason == reason);
        self.row = Some(Row { first_tick: row.map_or(tick, |row| row.first_tick), last_tick: tick, reason });
        if let Some(row) = row {
            // A row that is not among the worst has no place to be counted in.
            self.worst.iter_mut().filter(|case| case.tick == row.first_tick).for_each(|case| case.in_a_row += 1);
            return;
        }
        let case = self.case(tick, until_ns, opinion);
        let place = self.worst.partition_point(|other| other.late_us >= case.late_us);
        self.worst.insert(place, case);
        self.worst.truncate(WORST);
    }

    fn case(&self, tick: u64, until_ns: u64, opinion: Opinion) -> Case {
        let (begin_ns, deadline_ns) = (self.grid.begin_of(tick), self.grid.begin_of(tick + 1));
        let commands = self.traces.range(tick..).filter_map(|(_, trace)| trace[Role::Mixer as usize]);
        let sent_ns = commands.map(|passage| passage.send_ns).find(|ns| *ns > deadline_ns).unwrap_or(until_ns);
        let from_begin_us = |ns: u64| (ns as f64 - begin_ns as f64) / 1e3;
        let around = tick.saturating_sub(TIMELINE.0)..=tick + TIMELINE.1;
        let stage_of = |(role, passage): (Role, Passage)| TimelineStage {
            role: role.name().into(),
            wake_us: from_begin_us(passage.receive_ns),
            send_us: from_begin_us(passage.send_ns),
            is_fresh: passage.is_fresh,
        };
        let timeline = self.traces.range(around).map(|(tick, trace)| TimelineTick {
            tick: *tick,
            stages: STAGES.into_iter().zip(trace).filter_map(|(role, it)| Some(stage_of((role, (*it)?)))).collect(),
        });
        Case {
            tick,
            time_s: (begin_ns - self.grid.t0_ns) as f64 / 1e9,
            in_a_row: 1,
            late_us: sent_ns.saturating_sub(deadline_ns) as f64 / 1e3,
            class: opinion.class,
            stage: opinion.stage.map(|stage| stage.name().into()),
            evidence: opinion.evidence,
            timeline: timeline.collect(),
        }
    }

    /// Forgets what no miss can need any more.
    fn forget(&mut self, newest: u64) {
        let oldest = self.pending.front().copied().unwrap_or(newest).min(newest).saturating_sub(WINDOW_TICKS);
        self.traces = self.traces.split_off(&oldest);
        let oldest_ns = self.grid.begin_of(oldest).saturating_sub(SAMPLES_BEYOND_NS);
        while self.samples.front().is_some_and(|sample| sample.at_ns < oldest_ns) {
            self.samples.pop_front();
        }
    }

    /// What is known so far.
    #[must_use]
    pub fn section(&self) -> Section {
        let mut classes: Vec<ClassCount> = self
            .counts
            .iter()
            .map(|((class, stage), count)| ClassCount {
                class: *class,
                stage: stage.map(|stage| stage.name().into()),
                count: *count,
            })
            .collect();
        classes.sort_by_key(|class| std::cmp::Reverse(class.count));
        Section { classes, pending: self.pending.len() as u64, worst: self.worst.clone() }
    }
}

/// Whether a stage's driving input was of the message's tick.
fn is_fresh(role: Role, envelope: &Envelope) -> bool {
    index(role).checked_sub(1).is_none_or(|input| envelope.input_tick[input] == envelope.tick)
}
