//! Candidate causes of an outage, from time stamps and samples of kernel counters.
//!
//! The stamps are exact. Kernel counters are sampled each time the recorder runs, every 10 ms: their growth is known only
//! between two samples, and a stop that begins and ends between two samples is not seen.

use crate::processor_trace::{Runner, Slice, runners};
use messages::grid::Grid;
use messages::role::{Role, STAGES};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageTiming {
    pub receive_ns: u64,
    pub send_ns: u64,
    /// Its driving input was of the tick; otherwise it waited until its cut-off.
    pub is_fresh: bool,
}

impl StageTiming {
    const fn length_ns(&self) -> u64 {
        self.send_ns.saturating_sub(self.receive_ns)
    }
}

/// What each stage did in a tick, in the order of [`STAGES`]; nothing where it published nothing.
pub type TickTimings = [Option<StageTiming>; STAGES.len()];

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Life {
    /// It can, or nothing is known of it.
    #[default]
    Lives,
    Stopped,
    Dead,
}

/// What the kernel has counted for a stage's thread so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Process number: counters of another process are not comparable.
    pub pid: u64,
    pub life: Life,
    pub faults: u64,
    pub involuntary_switches: u64,
    /// Time that it was ready to run and did not have a processor [ns].
    pub waited_ns: u64,
    pub ran_ns: u64,
}

/// The unit of /proc/stat [ns].
pub const JIFFY_NS: u64 = 10_000_000;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CounterSample {
    /// Before the first counter was read: the counters of a stage that worked again by then are complete.
    pub from_ns: u64,
    /// After the last one was read.
    pub at_ns: u64,
    /// Of each stage, in the order of [`STAGES`].
    pub stages: [Counters; STAGES.len()],
    /// Time stolen from the loops' processor, or from all of them where they do not share one [`JIFFY_NS`].
    pub stolen: u64,
    /// Time that a process ran there, interrupts included [`JIFFY_NS`].
    pub busy: u64,
    pub lost: u64,
}

#[derive(Clone, Copy, Debug)]
pub struct TimingWindow<'a> {
    pub grid: Grid,
    pub outage: Outage,
    pub traces: &'a BTreeMap<u64, TickTimings>,
    pub samples: &'a [CounterSample],
    /// Who ran on the loops' processor; empty without a trace.
    pub slices: &'a [Slice],
    pub until_ns: u64,
    pub is_virtual: bool,
    /// All loops share one processor, so a sign of life of any loop is one of the processor.
    pub share_processor: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    pub is_stopped: bool,
    pub is_dead: bool,
    pub successor: Option<u64>,
    pub faults: u64,
    pub involuntary_switches: u64,
    pub waited_ns: u64,
    pub ran_ns: u64,
    /// Time stolen from the loops' processor, and time that it was busy; 0 where they do not share one [ns].
    pub stolen_ns: u64,
    pub busy_ns: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherStages {
    pub ran: bool,
    pub were_due: bool,
}

/// At the beginning of a span, stamps that still belong to what was before [% of a tick].
const HEAD_PERCENT: u64 = 5;
/// At the end of a span, stamps of stages that waited for the same thing and came first [% of a tick].
const TAIL_PERCENT: u64 = 20;

impl TimingWindow<'_> {
    /// Whether the recorder lost messages between the first and the last sample.
    pub fn messages_lost(&self) -> bool {
        let ends = self.samples.first().zip(self.samples.last());
        ends.is_some_and(|(first, last)| first.lost != last.lost)
    }

    /// The last sample before a span and the first one after it; nothing where it is not covered.
    fn around(&self, suspect: &CandidateCause) -> Option<(&CounterSample, &CounterSample)> {
        let mut after = self.samples.iter();
        Some((
            self.before(suspect)?,
            after.find(|sample| sample.from_ns >= suspect.to_ns)?,
        ))
    }

    fn before(&self, suspect: &CandidateCause) -> Option<&CounterSample> {
        self.samples
            .iter()
            .rfind(|sample| sample.at_ns <= suspect.from_ns)
    }

    /// What the counters of the late stage and its processor say of the time in which it was late.
    pub fn usage(&self, suspect: &CandidateCause) -> Usage {
        let stage = suspect.stage as usize;
        let of = |sample: &CounterSample| sample.stages[stage];
        // The end of a process that never came back may be seen long after.
        let never_back = suspect.to_ns >= self.until_ns;
        let until_ns = if never_back { u64::MAX } else { suspect.to_ns };
        let is_meanwhile =
            |it: &&CounterSample| it.at_ns >= suspect.from_ns && it.from_ns <= until_ns;
        let meanwhile = || self.samples.iter().filter(is_meanwhile);
        let has_been = |life: Life| meanwhile().any(|sample| of(sample).life == life);
        // A successor works before anybody looks.
        let next = self.samples.iter().find(|it| it.from_ns > until_ns);
        let mut pids = meanwhile().chain(next).map(|sample| of(sample).pid);
        let before = self.before(suspect).map(of);
        let successor = before.and_then(|before| pids.find(|pid| *pid != before.pid));
        let mut usage = Usage {
            is_stopped: has_been(Life::Stopped),
            is_dead: successor.is_some() || has_been(Life::Dead),
            successor,
            ..Usage::default()
        };
        let Some((first, last)) = self.around(suspect) else {
            return usage;
        };
        if of(first).pid == of(last).pid {
            let beyond = |count: fn(&Counters) -> u64| {
                self.beyond_usual(suspect, |sample| count(&of(sample)))
            };
            usage.faults = beyond(|counters| counters.faults);
            usage.involuntary_switches = beyond(|counters| counters.involuntary_switches);
            usage.waited_ns = beyond(|counters| counters.waited_ns);
            usage.ran_ns = beyond(|counters| counters.ran_ns);
        }
        if self.share_processor {
            usage.stolen_ns = last.stolen.saturating_sub(first.stolen) * JIFFY_NS;
            usage.busy_ns = self.beyond_usual(suspect, |sample| sample.busy) * JIFFY_NS;
        }
        usage
    }

    /// Who had the loops' processor while the stage was late, the longest first; nothing where no trace covers it.
    pub fn runner_times(&self, suspect: &CandidateCause) -> Option<Vec<(&Runner, u64)>> {
        let times = runners(self.slices, suspect.from_ns, suspect.to_ns);
        let times = times.filter(|_| self.share_processor)?;
        let mut times: Vec<(&Runner, u64)> = times.into_iter().collect();
        times.sort_by_key(|(_, ns)| std::cmp::Reverse(*ns));
        Some(times)
    }

    /// By how much a counter grew around a span, beyond what it usually does in that time: by its usual rate between
    /// samples outside the span.
    fn beyond_usual(&self, suspect: &CandidateCause, count: impl Fn(&CounterSample) -> u64) -> u64 {
        let Some((first, last)) = self.around(suspect) else {
            return 0;
        };
        let outside = |pair: &&[CounterSample]| {
            pair[1].at_ns <= suspect.from_ns || pair[0].from_ns >= suspect.to_ns
        };
        // Growth in a second, so that little of it is not rounded away.
        let rate = |pair: &[CounterSample]| {
            let growth = u128::from(count(&pair[1]).saturating_sub(count(&pair[0])));
            let ns = u128::from((pair[1].at_ns - pair[0].at_ns).max(1));
            u64::try_from(growth * 1_000_000_000 / ns).unwrap_or(u64::MAX)
        };
        let per_second = usual_of(self.samples.windows(2).filter(outside).map(rate).collect());
        let time_ns = u128::from(last.at_ns - first.at_ns);
        let usual = u128::from(per_second) * time_ns / 1_000_000_000;
        let grown = count(last).saturating_sub(count(first));
        grown.saturating_sub(u64::try_from(usual).unwrap_or(u64::MAX))
    }

    /// What the other stages on the same processor did while the stage was late; nothing is known where they do not
    /// share one.
    pub fn others(&self, suspect: &CandidateCause) -> Option<OtherStages> {
        if !self.share_processor {
            return None;
        }
        let period_ns = self.grid.period_ns;
        let from_ns = suspect.from_ns + period_ns * HEAD_PERCENT / 100;
        let to_ns = suspect.to_ns.saturating_sub(period_ns * TAIL_PERCENT / 100);
        let is_inside = |ns: u64| (from_ns..to_ns).contains(&ns);
        let mut others = OtherStages::default();
        for trace in self.traces.values() {
            for (stage, passage) in STAGES.into_iter().zip(trace) {
                if let Some(it) = passage.filter(|_| stage != suspect.stage) {
                    others.ran |= is_inside(it.receive_ns) || is_inside(it.send_ns);
                }
            }
        }
        // A tick's begin is the plant's to keep; its cut-off is the mixer's, unless it had worked the tick before.
        let first = self.grid.tick_at(from_ns);
        for tick in first..=first + 1 {
            let begin_ns = self.grid.begin_of(tick);
            let trace = self.traces.get(&tick);
            let mixed = trace.and_then(|trace| trace[Role::Mixer as usize]);
            let is_mixed = mixed.is_some_and(|passage| passage.send_ns <= suspect.from_ns);
            let cut_off_ns = self.grid.cut_off_of(Role::Mixer, tick);
            others.were_due |= suspect.stage != Role::Plant && is_inside(begin_ns);
            others.were_due |= suspect.stage != Role::Mixer && !is_mixed && is_inside(cut_off_ns);
        }
        Some(others)
    }

    pub fn recurs(&self, suspect: &CandidateCause) -> bool {
        let stage = suspect.stage as usize;
        let long = |passage: &StageTiming| {
            passage.receive_ns != suspect.from_ns && passage.length_ns() * 2 >= suspect.excess_ns
        };
        let mut passages = self.traces.values().filter_map(|trace| trace[stage]);
        passages.any(|passage| long(&passage))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delay {
    /// With its work of an earlier tick, in which it still was when it, or another stage on its processor, was due.
    Busy,
    /// With getting the processor after its timer, its input or its cut-off had come.
    Wake,
    Compute,
    /// With its output, so that the next stage waited until its cut-off.
    Input,
    /// With nothing: the next stage waited for an output that had been sent in time.
    Unused,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CandidateCause {
    pub stage: Role,
    pub delay: Delay,
    pub from_ns: u64,
    pub to_ns: u64,
    pub excess_ns: u64,
    /// How much of that certainly lies in the tick [ns]. A stage that published nothing for it may have been back from
    /// the beginning of the next tick on, when it was too late to publish.
    pub share_ns: u64,
}

impl CandidateCause {
    pub fn words(&self) -> String {
        let (stage, us) = (self.stage, self.excess_ns / 1000);
        let (before, did, longer) = match self.delay {
            Delay::Busy => ("", "was at work for", "in which a stage was due"),
            Delay::Wake => ("", "woke", "later than usual"),
            Delay::Compute => ("", "computed", "longer than usual"),
            Delay::Input => ("", "was waited for", "longer than usual"),
            Delay::Unused => (
                "what ",
                "had sent in time was waited for",
                "longer than usual",
            ),
        };
        format!("{before}{stage} {did} {us} us {longer}")
    }
}

/// What is usual among values: their lower quartile, because a disturbance that lasts must not pass for the usual.
pub(super) fn usual_of(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values.get(values.len() / 4).copied().unwrap_or(0)
}

impl TimingWindow<'_> {
    /// The delays in a tick that were longer than usual, in the order of the chain.
    pub fn suspects(&self, tick: u64) -> Vec<CandidateCause> {
        let begin_ns = self.grid.begin_of(tick);
        let trace = self.traces.get(&tick).copied().unwrap_or_default();
        let mut suspects = Vec::new();
        for (i, stage) in STAGES.into_iter().enumerate() {
            let before = i.checked_sub(1);
            let input = before.and_then(|before| trace[before]);
            let sent_ns = input.map(|passage| passage.send_ns);
            let cut_off_ns = self.grid.cut_off_of(stage, tick);
            let came_in_time = i == 0 || sent_ns.is_some_and(|ns| ns <= cut_off_ns);
            let is_fresh = trace[i].map_or(came_in_time, |passage| passage.is_fresh);
            let hop = |trace: &TickTimings| {
                let (own, sent) = (trace[i]?, trace[before?]?);
                let hop_ns = own.receive_ns.saturating_sub(sent.send_ns);
                own.is_fresh.then_some(hop_ns)
            };
            let (due_ns, usual_ns) = match sent_ns {
                _ if i == 0 => {
                    let late =
                        |k, trace: &TickTimings| Some(trace[0]?.receive_ns.saturating_sub(k));
                    (begin_ns, self.usual(late))
                }
                Some(sent_ns) if is_fresh => (sent_ns, self.usual(|_, trace| hop(trace))),
                _ => (cut_off_ns, 0),
            };
            if let (false, Some(before)) = (is_fresh, before) {
                let usual_ns =
                    self.usual(|begin, trace| Some(trace[before]?.send_ns.saturating_sub(begin)));
                let excess_ns = (cut_off_ns - begin_ns).saturating_sub(usual_ns);
                let came_ns = sent_ns.unwrap_or_else(|| self.next_sign_of(before, tick));
                let hop_ns = self.usual(|_, trace| hop(trace));
                let was_in_time = sent_ns.is_some_and(|ns| ns + hop_ns <= cut_off_ns);
                suspects.push(CandidateCause {
                    stage: STAGES[before],
                    delay: if was_in_time {
                        Delay::Unused
                    } else {
                        Delay::Input
                    },
                    from_ns: begin_ns + usual_ns,
                    to_ns: came_ns.max(cut_off_ns),
                    excess_ns,
                    share_ns: excess_ns,
                });
                // Without a state of the tick the outer loop publishes nothing, as it should.
                if stage == Role::Outer {
                    continue;
                }
            }
            let busy = self.at_work(i, due_ns, tick);
            let end_ns = self.grid.begin_of(tick + 1);
            if let Some(earlier) = busy {
                suspects.push(CandidateCause {
                    stage,
                    delay: Delay::Busy,
                    from_ns: earlier.receive_ns,
                    to_ns: earlier.send_ns,
                    excess_ns: earlier.send_ns - due_ns,
                    share_ns: earlier.send_ns.min(end_ns).saturating_sub(due_ns),
                });
            }
            let due_ns = busy.map_or(due_ns, |earlier| earlier.send_ns);
            let woken_ns = trace[i].map(|passage| passage.receive_ns);
            let receive_ns = woken_ns.unwrap_or_else(|| self.next_sign_of(i, tick));
            let sure_ns = woken_ns.unwrap_or(end_ns);
            suspects.push(CandidateCause {
                stage,
                delay: Delay::Wake,
                from_ns: due_ns,
                to_ns: receive_ns.max(due_ns),
                excess_ns: receive_ns.saturating_sub(due_ns).saturating_sub(usual_ns),
                share_ns: sure_ns.saturating_sub(due_ns).saturating_sub(usual_ns),
            });
            if let Some(passage) = trace[i] {
                let usual_ns = self.usual(|_, trace| Some(trace[i]?.length_ns()));
                let excess_ns = passage.length_ns().saturating_sub(usual_ns);
                suspects.push(CandidateCause {
                    stage,
                    delay: Delay::Compute,
                    from_ns: passage.receive_ns,
                    to_ns: passage.send_ns,
                    excess_ns,
                    share_ns: excess_ns,
                });
            }
        }
        suspects.retain(|suspect| suspect.share_ns > 0);
        suspects
    }

    /// The stage whose work took most of the time for which another one on the same processor did not wake.
    pub fn at_work_instead(&self, late: &CandidateCause) -> Option<CandidateCause> {
        if late.delay != Delay::Wake || !self.share_processor {
            return None;
        }
        let traces = self.traces.values();
        let works = traces.flat_map(|trace| STAGES.into_iter().zip(*trace));
        let works = works.filter_map(|(stage, passage)| {
            let passage = passage.filter(|_| stage != late.stage)?;
            let from_ns = passage.receive_ns.max(late.from_ns);
            let shared_ns = passage.send_ns.min(late.to_ns).saturating_sub(from_ns);
            Some((shared_ns, stage, passage))
        });
        let (shared_ns, stage, passage) = works.max_by_key(|(shared_ns, ..)| *shared_ns)?;
        (shared_ns * 2 > late.excess_ns).then_some(CandidateCause {
            stage,
            delay: Delay::Busy,
            from_ns: passage.receive_ns,
            to_ns: passage.send_ns,
            excess_ns: shared_ns,
            share_ns: shared_ns,
        })
    }

    /// The work of an earlier tick in which a stage was at an instant.
    fn at_work(&self, stage: usize, at_ns: u64, tick: u64) -> Option<StageTiming> {
        let mut before = self.traces.range(..tick).rev();
        let earlier = before.find_map(|(_, trace)| trace[stage])?;
        (earlier.receive_ns < at_ns && at_ns < earlier.send_ns).then_some(earlier)
    }

    /// What a duration usually is in the ticks around; `pick` is given the beginning of the tick.
    fn usual(&self, pick: impl Fn(u64, &TickTimings) -> Option<u64>) -> u64 {
        let is_around = |tick: &u64| !(self.outage.first..=self.outage.last).contains(tick);
        let others = self.traces.iter().filter(|(tick, _)| is_around(tick));
        let picked = others.filter_map(|(tick, trace)| pick(self.grid.begin_of(*tick), trace));
        usual_of(picked.collect())
    }

    /// When a stage woke for the first time after a tick that it left out [ns].
    fn next_sign_of(&self, stage: usize, tick: u64) -> u64 {
        let mut after = self.traces.range(tick + 1..);
        let later = after.find_map(|(_, trace)| trace[stage]);
        later.map_or(self.until_ns, |passage| passage.receive_ns)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outage {
    pub first: u64,
    pub last: u64,
    pub missed: u64,
}
