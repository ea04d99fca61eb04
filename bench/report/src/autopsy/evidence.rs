//! Evidence about an outage: time stamps and samples of kernel counters.
//!
//! The stamps are exact. Kernel counters are sampled each time the recorder looks, every 10 ms: their growth is known
//! only between two looks, and a stop that begins and ends between two looks is not seen.

use std::collections::BTreeMap;

use model::grid::Grid;
use model::role::{Role, STAGES};

use crate::autopsy::Outage;
use crate::autopsy::runners::{Runner, Slice, runners};
use crate::autopsy::suspects::{Suspect, usual_of};

/// A stage's work of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passage {
    /// When the stage woke for it [ns].
    pub receive_ns: u64,
    /// When its output was published [ns].
    pub send_ns: u64,
    /// Its driving input was of the tick; otherwise it waited until its cut-off.
    pub is_fresh: bool,
}

/// What each stage did in a tick, in the order of [`STAGES`]; nothing where it published nothing.
pub type TickPassages = [Option<Passage>; STAGES.len()];

/// Whether a process can run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Life {
    /// It can, or nothing is known of it.
    #[default]
    Lives,
    /// A signal or a debugger has stopped it.
    Stopped,
    /// It has ended.
    Dead,
}

/// What the kernel has counted for a stage's thread so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Process number: counters of another process are not comparable.
    pub pid: u64,
    /// Whether it can run.
    pub life: Life,
    /// Page faults of both kinds.
    pub faults: u64,
    /// Times that the processor was taken from it.
    pub involuntary_switches: u64,
    /// Time that it was ready to run and did not have a processor [ns].
    pub waited_ns: u64,
    /// Time that it ran [ns].
    pub ran_ns: u64,
}

/// The unit of /proc/stat [ns].
pub const JIFFY_NS: u64 = 10_000_000;

/// What was counted at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CounterSample {
    /// The instant [ns].
    pub at_ns: u64,
    /// Of each stage, in the order of [`STAGES`].
    pub stages: [Counters; STAGES.len()],
    /// Time stolen from the loops' processor, or from all of them where they do not share one [`JIFFY_NS`].
    pub stolen: u64,
    /// Time that somebody ran there, interrupts included [`JIFFY_NS`].
    pub busy: u64,
    /// Messages that the recorder has lost.
    pub lost: u64,
}

/// Everything that is known of the time around an outage.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Where ticks begin.
    pub grid: Grid,
    /// The outage.
    pub outage: Outage,
    /// Its ticks and those around it.
    pub traces: &'a BTreeMap<u64, TickPassages>,
    /// The samples around it, in order.
    pub samples: &'a [CounterSample],
    /// Who ran on the loops' processor; empty without a trace.
    pub slices: &'a [Slice],
    /// How far the traces reach [ns].
    pub until_ns: u64,
    /// A hypervisor may run below.
    pub is_virtual: bool,
    /// All loops share one processor, so a sign of life of any loop is one of the processor.
    pub share_processor: bool,
}

/// What a stage's counters say of a span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageUsage {
    /// It was seen stopped.
    pub is_stopped: bool,
    /// It was seen to have ended.
    pub is_dead: bool,
    /// The process that had its place afterwards.
    pub successor: Option<u64>,
    /// Page faults, beyond the usual.
    pub faults: u64,
    /// Involuntary switches, beyond the usual.
    pub involuntary_switches: u64,
    /// Waiting for the processor, beyond the usual [ns].
    pub waited_ns: u64,
    /// Running, beyond the usual [ns].
    pub ran_ns: u64,
}

/// What is known of the loops' processor in a span; nothing where they do not share one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProcessorUsage {
    /// What the host took [ns].
    pub stolen_ns: u64,
    /// What somebody ran, beyond the usual [ns].
    pub busy_ns: u64,
}

/// What the other stages did in a span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherStages {
    /// One of them left a stamp.
    pub ran: bool,
    /// One of them was due.
    pub were_due: bool,
}

/// At the beginning of a span, stamps that still belong to what was before [% of a tick].
const HEAD_PERCENT: u64 = 5;
/// At the end of a span, stamps of stages that waited for the same thing and came first [% of a tick].
const TAIL_PERCENT: u64 = 20;

impl Scene<'_> {
    /// Whether the recorder lost messages between the first and the last sample.
    #[must_use]
    pub fn messages_lost(&self) -> bool {
        self.samples.first().zip(self.samples.last()).is_some_and(|(first, last)| first.lost != last.lost)
    }

    /// The last sample before a span and the first one after it; nothing where it is not covered.
    fn around(&self, suspect: &Suspect) -> Option<(&CounterSample, &CounterSample)> {
        let first = self.samples.iter().rfind(|sample| sample.at_ns <= suspect.from_ns)?;
        Some((first, self.samples.iter().find(|sample| sample.at_ns >= suspect.to_ns)?))
    }

    /// What the late stage's counters say of the time in which it was late.
    #[must_use]
    pub fn usage(&self, suspect: &Suspect) -> StageUsage {
        let stage = suspect.stage as usize;
        let of = |sample: &CounterSample| sample.stages[stage];
        let mut usage = StageUsage::default();
        let before = self.samples.iter().rfind(|sample| sample.at_ns <= suspect.from_ns).map(of);
        // Whoever never came back may be seen to have ended long after.
        let until_ns = if suspect.to_ns >= self.until_ns { u64::MAX } else { suspect.to_ns };
        let meanwhile = |sample: &&CounterSample| (suspect.from_ns..=until_ns).contains(&sample.at_ns);
        usage.is_stopped = self.samples.iter().filter(meanwhile).any(|sample| of(sample).life == Life::Stopped);
        // A successor works before anybody looks.
        let next = self.samples.iter().find(|sample| sample.at_ns > until_ns);
        let mut pids = self.samples.iter().filter(meanwhile).chain(next).map(|sample| of(sample).pid);
        usage.successor = before.and_then(|before| pids.find(|pid| *pid != before.pid));
        usage.is_dead = usage.successor.is_some()
            || self.samples.iter().filter(meanwhile).any(|sample| of(sample).life == Life::Dead);
        let Some((first, last)) = self.around(suspect) else { return usage };
        if of(first).pid == of(last).pid {
            let beyond = |count: fn(&Counters) -> u64| self.beyond_usual(suspect, |sample| count(&of(sample)));
            usage.faults = beyond(|counters| counters.faults);
            usage.involuntary_switches = beyond(|counters| counters.involuntary_switches);
            usage.waited_ns = beyond(|counters| counters.waited_ns);
            usage.ran_ns = beyond(|counters| counters.ran_ns);
        }
        usage
    }

    /// Who had the loops' processor while the stage was late, the longest first; nothing where no trace covers it.
    #[must_use]
    pub fn ran(&self, suspect: &Suspect) -> Option<Vec<(&Runner, u64)>> {
        let times = runners(self.slices, suspect.from_ns, suspect.to_ns).filter(|_| self.share_processor)?;
        let mut times: Vec<(&Runner, u64)> = times.into_iter().collect();
        times.sort_by_key(|(_, ns)| std::cmp::Reverse(*ns));
        Some(times)
    }

    /// The thread of a stage, as far as it is known.
    #[must_use]
    pub fn thread_of(&self, stage: Role) -> Option<u64> {
        self.samples.last().map(|sample| sample.stages[stage as usize].pid)
    }

    /// What is known of the loops' processor while the stage was late.
    #[must_use]
    pub fn processor(&self, suspect: &Suspect) -> ProcessorUsage {
        let Some((first, last)) = self.around(suspect).filter(|_| self.share_processor) else {
            return ProcessorUsage::default();
        };
        ProcessorUsage {
            stolen_ns: last.stolen.saturating_sub(first.stolen) * JIFFY_NS,
            busy_ns: self.beyond_usual(suspect, |sample| sample.busy) * JIFFY_NS,
        }
    }

    /// By how much a counter grew around a span, beyond what it usually does in that time.
    fn beyond_usual(&self, suspect: &Suspect, count: impl Fn(&CounterSample) -> u64) -> u64 {
        let Some((first, last)) = self.around(suspect) else { return 0 };
        let grown = count(last).saturating_sub(count(first));
        grown.saturating_sub(self.usually(suspect, last.at_ns - first.at_ns, count))
    }

    /// By how much a counter usually grows in a time: by its usual rate between samples outside the span.
    fn usually(&self, suspect: &Suspect, time_ns: u64, count: impl Fn(&CounterSample) -> u64) -> u64 {
        let outside = |pair: &&[CounterSample]| pair[1].at_ns <= suspect.from_ns || pair[0].at_ns >= suspect.to_ns;
        // Growth in a second, so that little of it is not rounded away.
        let rate = |pair: &[CounterSample]| {
            let growth = u128::from(count(&pair[1]).saturating_sub(count(&pair[0])));
            let ns = u128::from((pair[1].at_ns - pair[0].at_ns).max(1));
            u64::try_from(growth * 1_000_000_000 / ns).unwrap_or(u64::MAX)
        };
        let per_second = usual_of(self.samples.windows(2).filter(outside).map(rate).collect());
        u64::try_from(u128::from(per_second) * u128::from(time_ns) / 1_000_000_000).unwrap_or(u64::MAX)
    }

    /// What the other stages on the same processor did while the stage was late; nothing is known where they do not
    /// share one.
    #[must_use]
    pub fn others(&self, suspect: &Suspect) -> Option<OtherStages> {
        if !self.share_processor {
            return None;
        }
        let period_ns = self.grid.period_ns;
        let from_ns = suspect.from_ns + period_ns * HEAD_PERCENT / 100;
        let to_ns = suspect.to_ns.saturating_sub(period_ns * TAIL_PERCENT / 100);
        let is_inside = |ns: u64| (from_ns..to_ns).contains(&ns);
        let mut others = OtherStages::default();
        for trace in self.traces.values() {
            for passage in (0..STAGES.len()).filter(|i| *i != suspect.stage as usize).filter_map(|i| trace[i]) {
                others.ran |= is_inside(passage.receive_ns) || is_inside(passage.send_ns);
            }
        }
        // A tick's begin is the plant's to keep; its cut-off is the mixer's, unless it had worked the tick before.
        let first = self.grid.tick_at(from_ns);
        for tick in first..=first + 1 {
            let begin_ns = self.grid.begin_of(tick);
            let mixed = self.traces.get(&tick).and_then(|trace| trace[Role::Mixer as usize]);
            let is_mixed = mixed.is_some_and(|passage| passage.send_ns <= suspect.from_ns);
            let cut_off_ns = self.grid.cut_off_of(Role::Mixer, tick);
            others.were_due |= suspect.stage != Role::Plant && is_inside(begin_ns);
            others.were_due |= suspect.stage != Role::Mixer && !is_mixed && is_inside(cut_off_ns);
        }
        Some(others)
    }

    /// Whether the stage computed long in another tick around, too.
    #[must_use]
    pub fn recurs(&self, suspect: &Suspect) -> bool {
        let stage = suspect.stage as usize;
        let long = |passage: &Passage| {
            passage.receive_ns != suspect.from_ns
                && passage.send_ns.saturating_sub(passage.receive_ns) * 2 >= suspect.excess_ns
        };
        self.traces.values().filter_map(|trace| trace[stage]).any(|passage| long(&passage))
    }
}
