//! Root-cause analysis of outages: when they began, how long they lasted, how many deadlines they cost, and why.
//!
//! ```text
//!   tick        41     42     43     44     45     46
//!   plant       .      .      .      .      .      .
//!   outer       .      .      .      .      .      .        . worked, with the input of its tick
//!   inner       .      -      -      -      .      .        - published nothing
//!   mixer       .      *      *      *      .      .        * worked without the input of its tick
//!                      |---- one outage --|
//! ```
//!
//! A tick is *out* when a deadline was missed for its command, or a stage left it out, or worked it without its input.
//! An outage is a row of such ticks, however long. It has one cause ([`crate::miss_causes`]), which may be unknown. Every
//! missed deadline belongs to one outage.

use crate::losses::Losses;
use crate::miss_causes::{Attribution, MissCause};
use crate::observations::{CounterSample, Life, Observations, Outage, StageTiming, TickTimings};
use crate::outages::{CauseCount, OutageCase, OutageSection, TimelineStage, TimelineTick};
use crate::processor_trace::Slice;
use crate::schema::MACHINE;
use messages::content::{Loss, State};
use messages::grid::Grid;
use messages::header::Message;
use messages::role::{MOST_CHANNELS, Role, STAGES};
use messages::topic::Topic;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Ticks that are kept before and after an outage: what is usual is seen in them.
pub const AROUND_TICKS: u64 = 32;
/// An outage is classed as it stands when it has lasted for so many ticks; what follows is another one.
const LONGEST_TICKS: u64 = 60_000;
const WORST: usize = 100;
/// Ticks before and after the first tick of an outage, and its last one, in its timeline: what lies between two such
/// ends of a long one is all alike.
const TIMELINE: (u64, u64) = (1, 2);
/// Samples that are kept beyond those of the ticks [ns].
const SAMPLES_BEYOND_NS: u64 = 200_000_000;

#[derive(Clone, Debug, Default)]
pub struct MissAnalysis {
    grid: Grid,
    period_s: f64,
    leads_ns: [u64; MOST_CHANNELS],
    share_processor: bool,
    traces: BTreeMap<u64, TickTimings>,
    samples: VecDeque<CounterSample>,
    /// Who ran on the loops' processor, where it is traced.
    slices: VecDeque<Slice>,
    /// Tick of the newest state: the plant has judged the commands of all ticks before.
    newest_state: u64,
    /// Missed deadlines that were taken.
    misses: u64,
    losses: Losses,
    /// Ticks whose commands missed their deadlines, as long as their stamps are kept.
    missed: BTreeSet<u64>,
    /// Stages from which a message fault withheld an input of a tick.
    withheld: BTreeSet<(u64, Role)>,
    /// The next tick to look at: from it on, misses are in no outage yet. None before the first state.
    next: Option<u64>,
    /// Whether every stage has worked a tick: what is not there before has not begun yet.
    has_begun: bool,
    open: Option<Outage>,
    counts: BTreeMap<(MissCause, Option<Role>), (u64, u64)>,
    rows: OutageRuns,
    worst: Vec<OutageCase>,
}

impl MissAnalysis {
    /// `leads_ns`: what each channel leaves to the plant's lead in a tick. `period_s`: length of a tick in flight time [s].
    pub fn new(
        grid: Grid,
        period_s: f64,
        share_processor: bool,
        leads_ns: [u64; MOST_CHANNELS],
    ) -> Self {
        Self {
            grid,
            period_s,
            leads_ns,
            share_processor,
            ..Self::default()
        }
    }

    pub fn stamps<C: Topic>(&mut self, message: &Message<C>) {
        let (role, envelope) = (C::SENDER, &message.envelope);
        let stamps = envelope.stamps_of(role);
        let input = index(role).checked_sub(1);
        let passage = StageTiming {
            receive_ns: stamps.receive_ns,
            send_ns: stamps.send_ns,
            is_fresh: input.is_none_or(|input| envelope.input_tick[input] == envelope.tick),
        };
        self.traces.entry(envelope.tick).or_default()[index(role)] = Some(passage);
    }

    /// Takes a state. The misses up to its tick have been taken.
    pub fn state(&mut self, message: &Message<State>) {
        self.stamps(message);
        self.newest_state = message.envelope.tick;
        // The first ticks of a flight may be missed before any state is sent.
        let first = self.missed.first().copied().unwrap_or(u64::MAX);
        self.next.get_or_insert(first.min(self.newest_state));
    }

    pub fn loss(&mut self, loss: &Loss) {
        self.losses.take(loss);
    }

    /// Takes a missed deadline of the command of a tick.
    pub fn miss(&mut self, tick: u64) {
        self.misses += 1;
        self.missed.insert(tick);
        // A plant that was stopped for very long judges ticks that were looked at.
        let was_looked_at = self.next.is_some_and(|next| tick < next);
        match self.open.as_mut().filter(|outage| outage.first <= tick) {
            _ if !was_looked_at => {}
            Some(outage) => outage.missed += 1,
            None => self.count_unplaced(1),
        }
    }

    /// Takes that a message fault withheld a message of a tick from a stage.
    pub fn withheld(&mut self, tick: u64, stage: Role) {
        self.withheld.insert((tick, stage));
    }

    /// Takes missed deadlines whose ticks are not known, because states or decisions were lost.
    pub fn misses_unseen(&mut self, count: u64) {
        self.misses += count;
        self.count_unplaced(count);
    }

    pub fn sample(&mut self, sample: CounterSample) {
        self.samples.push_back(sample);
    }

    pub fn slices(&mut self, slices: Vec<Slice>) {
        self.slices.extend(slices);
    }

    /// Takes which stages ended without landing, seen at an instant after the last sample: such an end ends the run,
    /// most often before the next sample would have shown it.
    pub fn ended_stages(&mut self, stages: [bool; STAGES.len()], at_ns: u64) {
        let mut sample = self.samples.back().copied().unwrap_or_default();
        (sample.from_ns, sample.at_ns) = (at_ns, at_ns);
        for (counters, has_fallen) in sample.stages.iter_mut().zip(stages) {
            if has_fallen {
                counters.life = Life::Dead;
            }
        }
        self.samples.push_back(sample);
    }

    /// Classes the outages that are over. Every message that was sent before the newest state has been taken: what a stage
    /// had not sent [`AROUND_TICKS`] after a tick, it did not send in the tick.
    pub fn look(&mut self) {
        let longest = self.newest().saturating_sub(LONGEST_TICKS);
        let horizon = self.newest_state.max(longest);
        while let Some(tick) = self.next.filter(|tick| tick + AROUND_TICKS <= horizon) {
            self.look_at(tick);
        }
        self.forget(horizon);
    }

    /// Classes what is left: the flight is over, with this number of missed deadlines.
    pub fn finish(&mut self, missed: u64) {
        let last = self.newest().max(self.missed.last().copied().unwrap_or(0));
        while let Some(tick) = self.next.filter(|tick| *tick <= last) {
            self.look_at(tick);
        }
        // Stages need not work the last tick of a flight that ends before its time.
        match self.open.take() {
            Some(outage) if outage.missed > 0 || outage.first + 1 < last => self.close(outage),
            _ => {}
        }
        // Of ticks before the first one that was seen.
        let unseen = missed.saturating_sub(self.misses);
        self.count_unplaced(unseen + self.not_looked_at());
        self.missed.clear();
    }

    fn newest(&self) -> u64 {
        self.traces.last_key_value().map_or(0, |(tick, _)| *tick)
    }

    fn look_at(&mut self, tick: u64) {
        self.next = Some(tick + 1);
        let missed = u64::from(self.missed.contains(&tick));
        let trace = self.traces.get(&tick).copied().unwrap_or_default();
        let mut passages = trace.iter();
        let is_whole = passages.all(|passage| passage.is_some_and(|it| it.is_fresh));
        self.has_begun |= is_whole;
        let is_unknown = self.losses.lacks_any(tick);
        let is_out = missed > 0 || (self.has_begun && !is_whole && !is_unknown);
        let lasts = |outage: &&mut Outage| is_out && tick - outage.first < LONGEST_TICKS;
        if let Some(outage) = self.open.as_mut().filter(lasts) {
            (outage.last, outage.missed) = (tick, outage.missed + missed);
            return;
        }
        if let Some(outage) = self.open.take() {
            self.close(outage);
        }
        let (first, last) = (tick, tick);
        self.open = is_out.then_some(Outage {
            first,
            last,
            missed,
        });
    }

    fn not_looked_at(&self) -> u64 {
        self.missed.range(self.next.unwrap_or(0)..).count() as u64
    }

    fn count_unplaced(&mut self, missed: u64) {
        if missed > 0 {
            let count = self.counts.entry((MissCause::CannotTell, None));
            count.or_default().1 += missed;
        }
    }

    fn close(&mut self, outage: Outage) {
        let first = outage.first.saturating_sub(AROUND_TICKS);
        let around = self.traces.range(first..=outage.last + AROUND_TICKS);
        let traces: BTreeMap<u64, TickTimings> = around.map(|(tick, it)| (*tick, *it)).collect();
        let passages = traces.values().flatten().flatten();
        let end_ns = self.grid.begin_of(outage.last + 1);
        let until_ns = passages
            .map(|passage| passage.send_ns)
            .fold(end_ns, u64::max);
        let seen = Observations {
            grid: self.grid,
            leads_ns: self.leads_ns,
            timings: &traces,
            withheld: &self.withheld,
            samples: self.samples.make_contiguous(),
            slices: self.slices.make_contiguous(),
            outage,
            messages_lost: (outage.first..=outage.last).any(|it| self.losses.lacks_any(it)),
            until_ns,
            share_processor: self.share_processor,
        };
        // What the recorder did not see is no outage of the loop.
        let is_whole = !seen.messages_lost;
        if outage.missed == 0 && !is_whole {
            return;
        }
        let found = Attribution::of(&seen);
        let cause = (found.class, found.stage());
        let (outages, missed) = self.counts.entry(cause).or_default();
        (*outages, *missed) = (*outages + 1, *missed + outage.missed);
        // Nor is a stage that it did not see published.
        if is_whole {
            let trace = |tick| self.traces.get(&tick).copied().unwrap_or_default();
            self.rows.take(outage, |tick| {
                out_in(&trace(tick), &seen, tick, self.missed.contains(&tick))
            });
        } else {
            self.rows.unmeasured += 1;
        }
        let case = self.case(outage, found);
        let place = self
            .worst
            .partition_point(|it| it.weight() >= case.weight());
        self.worst.insert(place, case);
        self.worst.truncate(WORST);
    }

    fn case(&self, outage: Outage, found: Attribution) -> OutageCase {
        let begin_ns = self.grid.begin_of(outage.first);
        let from_begin_us = |ns: u64| (ns as f64 - begin_ns as f64) / 1e3;
        let around = |tick: u64| tick.saturating_sub(TIMELINE.0)..=tick + TIMELINE.1;
        let shown: BTreeSet<u64> = around(outage.first).chain(around(outage.last)).collect();
        let stage_of = |(role, passage): (Role, &Option<StageTiming>)| {
            let passage = passage.as_ref()?;
            Some(TimelineStage {
                role: role.name().into(),
                wake_us: from_begin_us(passage.receive_ns),
                send_us: from_begin_us(passage.send_ns),
                is_fresh: passage.is_fresh,
            })
        };
        let stages_of = |trace: &TickTimings| -> Vec<TimelineStage> {
            STAGES.into_iter().zip(trace).filter_map(stage_of).collect()
        };
        let seen = self.newest().max(outage.last);
        let timeline = shown.range(..=seen).map(|tick| TimelineTick {
            tick: *tick,
            missed: self.missed.contains(tick),
            stages: self.traces.get(tick).map(stages_of).unwrap_or_default(),
        });
        OutageCase {
            tick: outage.first,
            time_s: outage.first as f64 * self.period_s,
            ticks: outage.last - outage.first + 1,
            missed: outage.missed,
            delay_us: found.delay.map_or(0.0, |it| it.length_ns() as f64 / 1e3),
            due_us: found.delay.map_or(0.0, |it| from_begin_us(it.from_ns)),
            class: found.class,
            stage: found.stage().map(|stage| stage.name().into()),
            evidence: found.evidence,
            ran: found.ran,
            faults: Vec::new(),
            timeline: timeline.collect(),
        }
    }

    fn forget(&mut self, newest: u64) {
        let open = self.open.map(|outage| outage.first);
        let oldest = open
            .or(self.next)
            .unwrap_or(newest)
            .saturating_sub(AROUND_TICKS);
        self.traces = self.traces.split_off(&oldest);
        self.missed = self.missed.split_off(&oldest);
        self.withheld = self.withheld.split_off(&(oldest, Role::Plant));
        let oldest_ns = self.grid.begin_of(oldest).saturating_sub(SAMPLES_BEYOND_NS);
        while self
            .samples
            .pop_front_if(|it| it.at_ns < oldest_ns)
            .is_some()
        {}
        while self
            .slices
            .pop_front_if(|it| it.to_ns < oldest_ns)
            .is_some()
        {}
    }

    pub fn section(&self) -> OutageSection {
        type Counted<'a> = (&'a (MissCause, Option<Role>), &'a (u64, u64));
        let class = |((class, stage), (outages, missed)): Counted<'_>| CauseCount {
            class: *class,
            stage: stage.map(|stage| stage.name().into()),
            outages: *outages,
            missed: *missed,
        };
        let mut classes: Vec<CauseCount> = self.counts.iter().map(class).collect();
        classes.sort_by_key(|class| std::cmp::Reverse((class.missed, class.outages)));
        let open = self.open.map_or(0, |outage| outage.missed);
        OutageSection {
            classes,
            pending: self.not_looked_at() + open,
            longest: self.rows.longest(),
            unmeasured: self.rows.unmeasured,
            worst: self.worst.clone(),
        }
    }
}

const ROWS: usize = STAGES.len() + 1;

/// The longest rows so far, of each stage and of all at once.
#[derive(Clone, Copy, Debug, Default)]
struct OutageRuns {
    longest: [u64; ROWS],
    /// OutageRuns that last at the end of the outage that was taken last.
    running: [u64; ROWS],
    next: u64,
    unmeasured: u64,
}

impl OutageRuns {
    /// Takes an outage, whose stages were out as `out_in` says of each tick. One that begins where the last one was cut
    /// off goes on with it.
    fn take(&mut self, outage: Outage, out_in: impl Fn(u64) -> [bool; STAGES.len()]) {
        if outage.first != self.next {
            self.running = [0; ROWS];
        }
        self.next = outage.last + 1;
        for tick in outage.first..=outage.last {
            let out = out_in(tick);
            let all = out.iter().all(|is_out| *is_out);
            let rows = self.running.iter_mut().zip(&mut self.longest);
            for ((row, longest), is_out) in rows.zip(out.into_iter().chain([all])) {
                *row = if is_out { *row + 1 } else { 0 };
                *longest = (*longest).max(*row);
            }
        }
    }

    /// The longest of each stage that had one, and of [`MACHINE`] [ticks].
    fn longest(&self) -> BTreeMap<String, u64> {
        let names = STAGES.into_iter().map(|role| role.name()).chain([MACHINE]);
        let longest = names.map(str::to_owned).zip(self.longest);
        longest.filter(|(_, ticks)| *ticks > 0).collect()
    }
}

/// Stages of the loop by their place in [`STAGES`].
fn index(role: Role) -> usize {
    (role as usize).min(STAGES.len() - 1)
}

/// Which stages published nothing in a tick, or too late for the next one. What came in time and was not used is no
/// outage of its sender; `is_missed` says that the tick's command missed its deadline.
fn out_in(
    trace: &TickTimings,
    seen: &Observations<'_>,
    tick: u64,
    is_missed: bool,
) -> [bool; STAGES.len()] {
    std::array::from_fn(|i| {
        let Some(passage) = trace[i] else { return true };
        let (due_ns, is_used) = match STAGES.get(i + 1) {
            Some(next) => (
                seen.cut_off_of(*next, tick),
                trace[i + 1].is_some_and(|next| next.is_fresh),
            ),
            None => (seen.grid.begin_of(tick + 1), !is_missed),
        };
        !is_used && passage.send_ns > due_ns
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outage_that_was_cut_off_goes_on_and_another_one_does_not() {
        for (next, longest) in [(200, 150), (201, 100)] {
            let mut rows = OutageRuns::default();
            for (first, last) in [(100, 199), (next, next + 49)] {
                let missed = 0;
                let outage = Outage {
                    first,
                    last,
                    missed,
                };
                rows.take(outage, |_| [false, false, true, false]);
            }
            assert_eq!(rows.longest, [0, 0, longest, 0, 0]);
        }
        // A stage that works within an outage begins a new run.
        let mut rows = OutageRuns::default();
        let outage = Outage {
            first: 1,
            last: 29,
            missed: 0,
        };
        rows.take(outage, |tick| [true, !tick.is_multiple_of(10), true, true]);
        assert_eq!(rows.longest, [29, 9, 29, 29, 9]);
    }
}
