//! Observations of an outage: the time stamps of messages, samples of kernel counters, and the kernel trace.
//!
//! The stamps are exact. Kernel counters are sampled each time the recorder runs, every 10 ms: their growth is known only
//! between two samples, and a stop that begins and ends between two samples is not seen.

use crate::phrase::{count, list};
use crate::processor_trace::{Runner, Slice, runners};
use messages::grid::Grid;
use messages::role::{MOST_CHANNELS, Role, STAGES};
use std::collections::{BTreeMap, BTreeSet};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageTiming {
    pub receive_ns: u64,
    pub send_ns: u64,
    /// Its driving input was of the tick; otherwise it waited until its cut-off.
    pub is_fresh: bool,
}

/// Timing of each stage in a tick, in the order of [`STAGES`]; nothing where it published nothing.
pub type TickTimings = [Option<StageTiming>; STAGES.len()];

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Life {
    /// The process runs, or nothing is known of it.
    #[default]
    Lives,
    Stopped,
    Dead,
}

/// Kernel counters of a stage's thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Process number: counters of another process are not comparable.
    pub pid: u64,
    pub life: Life,
    pub faults: u64,
    /// Time that it was ready to run and did not have a processor [ns].
    pub waited_ns: u64,
    pub ran_ns: u64,
    /// Time for which a used-up processor quota stopped it [us]; 0 for a real-time thread, which no quota stops.
    pub throttled_us: u64,
}

/// The unit of /proc/stat [ns].
pub const JIFFY_NS: u64 = 10_000_000;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CounterSample {
    /// Before the first counter was read: the counters of a stage that worked again by then are complete.
    pub from_ns: u64,
    /// After the last one was read.
    pub at_ns: u64,
    /// The channel whose commands flew.
    pub channel: u64,
    /// Of the plant and of each stage of the channel, in the order of [`STAGES`].
    pub stages: [Counters; STAGES.len()],
    /// Time stolen from the loops' processor, or from all of them where they do not share one [`JIFFY_NS`].
    pub stolen: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outage {
    pub first: u64,
    pub last: u64,
    pub missed: u64,
}

/// Part of a stage's work that took longer than usual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delay {
    pub stage: Role,
    /// From waking to sending; otherwise from the instant when it was due to its waking.
    pub is_compute: bool,
    /// It worked without the message of the stage before, which had been sent in time.
    pub is_without_input: bool,
    pub from_ns: u64,
    /// Its next sign of life.
    pub to_ns: u64,
    pub excess_ns: u64,
}

impl Delay {
    pub const fn length_ns(&self) -> u64 {
        self.to_ns - self.from_ns
    }

    pub fn words(&self) -> String {
        let (stage, us) = (self.stage, self.excess_ns / 1000);
        match self.is_compute {
            true => format!("{stage} computed {us} us longer than usual"),
            false => format!("{stage} woke {us} us later than usual"),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    pub grid: Grid,
    /// Time at the end of a tick that each channel leaves to the plant's lead [ns].
    pub leads_ns: [u64; MOST_CHANNELS],
    pub outage: Outage,
    /// The recorder lost messages of its ticks.
    pub messages_lost: bool,
    pub timings: &'a BTreeMap<u64, TickTimings>,
    /// Stages from which a message fault withheld an input of a tick.
    pub withheld: &'a BTreeSet<(u64, Role)>,
    pub samples: &'a [CounterSample],
    /// Who ran on the loops' processor; empty without a trace.
    pub slices: &'a [Slice],
    pub until_ns: u64,
    /// All loops share one processor.
    pub share_processor: bool,
}

impl Observations<'_> {
    fn withheld(&self) -> impl Iterator<Item = (u64, Role)> {
        let Outage { first, last, .. } = self.outage;
        let of_outage = (first, Role::Plant)..(last + 1, Role::Plant);
        self.withheld.range(of_outage).copied()
    }

    pub const fn outage_ns(&self) -> u64 {
        (self.outage.last + 1 - self.outage.first) * self.grid.period_ns
    }

    /// In how much of the outage a message fault withheld an input [ns].
    pub fn withheld_ns(&self) -> u64 {
        let ticks: BTreeSet<u64> = self.withheld().map(|(tick, _)| tick).collect();
        ticks.len() as u64 * self.grid.period_ns
    }

    pub fn is_withheld_from(&self, stage: Role) -> bool {
        self.withheld().any(|(_, of)| of == stage)
    }

    /// The stages from which message faults withheld inputs in the outage, and in how many ticks.
    pub fn withheld_words(&self) -> String {
        let ticks = |role: Role| self.withheld().filter(|(_, of)| *of == role).count() as u64;
        let stages = STAGES.into_iter().map(|role| (role, ticks(role)));
        let stages = stages.filter(|(_, ticks)| *ticks > 0);
        let stages = stages.map(|(role, ticks)| format!("{role} in {}", count(ticks, "tick")));
        format!("message faults withheld an input of {}", list(stages))
    }

    /// The cut-off of a stage in the channel that flew by the last sample before the tick [ns].
    pub fn cut_off_of(&self, stage: Role, tick: u64) -> u64 {
        let begin_ns = self.grid.begin_of(tick);
        let after = self.samples.partition_point(|it| it.at_ns <= begin_ns);
        let before = self.samples[..after].last();
        let lead_ns = before.and_then(|it| self.leads_ns.get(it.channel as usize));
        let lead_ns = *lead_ns.unwrap_or(&0);
        self.grid.cut_off_of(stage, tick, lead_ns)
    }

    /// Delays of the outage. A stage that waits for one that is late is not late itself.
    pub fn delays(&self) -> Vec<Delay> {
        let usual_ns: [[u64; 2]; STAGES.len()] = std::array::from_fn(|stage| self.usual_ns(stage));
        // The next sign of life of each stage.
        let mut seen_ns = [0; STAGES.len()];
        let mut delays = Vec::new();
        for tick in self.outage.first..=self.outage.last {
            let timings = self.timings.get(&tick).copied().unwrap_or_default();
            let mut due_ns = self.grid.begin_of(tick);
            for (i, stage) in STAGES.into_iter().enumerate() {
                let input = i.checked_sub(1).and_then(|before| timings[before]);
                if i > 0 && (input, timings[i]) == (None, None) {
                    continue;
                }
                let from_ns = due_ns.max(seen_ns[i]);
                let [wake_ns, send_ns] = match timings[i] {
                    Some(it) => [it.receive_ns, it.send_ns],
                    None if seen_ns[i] > due_ns => [seen_ns[i]; 2],
                    None => [self.next_sign_of(i, tick); 2],
                };
                let cut_off_ns = self.cut_off_of(stage, tick);
                let is_stale = timings[i].is_some_and(|it| !it.is_fresh);
                let came_in_time =
                    input.is_some_and(|it| it.send_ns + usual_ns[i][0] <= cut_off_ns);
                let parts = [(from_ns, wake_ns), (wake_ns.max(from_ns), send_ns)];
                for (is_compute, (from_ns, to_ns)) in [false, true].into_iter().zip(parts) {
                    let length_ns = to_ns.saturating_sub(from_ns);
                    let delay = Delay {
                        stage,
                        is_compute,
                        is_without_input: is_stale && came_in_time && !is_compute,
                        from_ns,
                        to_ns,
                        excess_ns: length_ns.saturating_sub(usual_ns[i][usize::from(is_compute)]),
                    };
                    delays.extend(Some(delay).filter(|it| it.excess_ns > 0));
                }
                seen_ns[i] = send_ns;
                due_ns = due_ns.max(send_ns);
            }
        }
        delays
    }

    /// Usual times of a stage, from due to waking and from waking to sending: lower quartiles of the ticks around, because
    /// a disturbance that lasts must not pass for the usual.
    fn usual_ns(&self, stage: usize) -> [u64; 2] {
        let outage = self.outage.first..=self.outage.last;
        let others = self
            .timings
            .iter()
            .filter(|(tick, _)| !outage.contains(tick));
        let worked = others.filter_map(|(tick, timings)| {
            let timing = timings[stage].filter(|it| it.is_fresh)?;
            let due_ns = match stage.checked_sub(1) {
                Some(before) => timings[before]?.send_ns,
                None => self.grid.begin_of(*tick),
            };
            Some([
                timing.receive_ns.saturating_sub(due_ns),
                timing.send_ns.saturating_sub(timing.receive_ns),
            ])
        });
        let worked: Vec<[u64; 2]> = worked.collect();
        [0, 1].map(|part| lower_quartile(worked.iter().map(|times| times[part]).collect()))
    }

    /// When a stage woke for the first time after a tick that it left out [ns].
    fn next_sign_of(&self, stage: usize, tick: u64) -> u64 {
        let mut after = self.timings.range(tick + 1..);
        let later = after.find_map(|(_, timings)| timings[stage]);
        later.map_or(self.until_ns, |timing| timing.receive_ns)
    }

    fn before(&self, delay: &Delay) -> Option<&CounterSample> {
        let mut before = self.samples.iter().rev();
        before.find(|sample| sample.at_ns <= delay.from_ns)
    }

    fn after(&self, delay: &Delay) -> Option<&CounterSample> {
        let mut after = self.samples.iter();
        after.find(|sample| sample.from_ns >= delay.to_ns)
    }

    /// The last sample before a delay and the first one after it; nothing where it is not covered.
    fn around(&self, delay: &Delay) -> Option<[&CounterSample; 2]> {
        Some([self.before(delay)?, self.after(delay)?])
    }

    /// Samples that were taken during a delay. The end of a process that never came back may be seen long after.
    fn during(&self, delay: &Delay) -> impl Iterator<Item = &CounterSample> {
        let until_ns = match delay.to_ns >= self.until_ns {
            true => u64::MAX,
            false => delay.to_ns,
        };
        let from_ns = delay.from_ns;
        let samples = self.samples.iter();
        samples.filter(move |it| it.at_ns >= from_ns && it.from_ns <= until_ns)
    }

    /// Whether a sample showed the stage's process in this state during a delay.
    pub fn has_been(&self, delay: &Delay, life: Life) -> bool {
        let stage = delay.stage as usize;
        self.during(delay).any(|it| it.stages[stage].life == life)
    }

    /// The process that took the place of the stage's during a delay; it works before a sample shows it.
    pub fn successor(&self, delay: &Delay) -> Option<u64> {
        let pid = |sample: &CounterSample| sample.stages[delay.stage as usize].pid;
        let before = self.before(delay)?;
        let mut shown = self.during(delay).chain(self.after(delay));
        shown
            .find(|it| it.channel == before.channel && pid(it) != pid(before))
            .map(pid)
    }

    /// Growth of a counter of the stage around a delay, beyond what is usual in that time: by its usual rate between
    /// samples outside the outage, or where there are none, outside the delay. Nothing where another process counted.
    pub fn grown(&self, delay: &Delay, count: fn(&Counters) -> u64) -> u64 {
        let of = |sample: &CounterSample| sample.stages[delay.stage as usize];
        let count = |sample: &CounterSample| count(&of(sample));
        let Some([first, last]) = self.around(delay) else {
            return 0;
        };
        if of(first).pid != of(last).pid {
            return 0;
        }
        let outside = |begin_ns: u64, end_ns: u64| {
            let pairs = self.samples.windows(2);
            pairs.filter(move |pair| pair[1].at_ns <= begin_ns || pair[0].from_ns >= end_ns)
        };
        let begin_ns = self.grid.begin_of(self.outage.first).min(delay.from_ns);
        let end_ns = self.grid.begin_of(self.outage.last + 1).max(delay.to_ns);
        // Growth in a second, so that little of it is not rounded away.
        let rate = |pair: &[CounterSample]| {
            let growth = u128::from(count(&pair[1]).saturating_sub(count(&pair[0])));
            let ns = u128::from((pair[1].at_ns - pair[0].at_ns).max(1));
            u64::try_from(growth * 1_000_000_000 / ns).unwrap_or(u64::MAX)
        };
        let mut rates: Vec<u64> = outside(begin_ns, end_ns).map(rate).collect();
        if rates.is_empty() {
            rates = outside(delay.from_ns, delay.to_ns).map(rate).collect();
        }
        let per_second = lower_quartile(rates);
        let time_ns = u128::from(last.at_ns - first.at_ns);
        let usual = u128::from(per_second) * time_ns / 1_000_000_000;
        let grown = count(last).saturating_sub(count(first));
        grown.saturating_sub(u64::try_from(usual).unwrap_or(u64::MAX))
    }

    /// Time stolen from the loops' processor around a delay; 0 where they do not share one [ns].
    pub fn stolen_ns(&self, delay: &Delay) -> u64 {
        let around = self.around(delay).filter(|_| self.share_processor);
        around.map_or(0, |[first, last]| {
            last.stolen.saturating_sub(first.stolen) * JIFFY_NS
        })
    }

    /// Who had the loops' processor during a delay, the longest first; empty where no trace covers it.
    pub fn ran(&self, delay: &Delay) -> Vec<(&Runner, u64)> {
        let times = runners(self.slices, delay.from_ns, delay.to_ns);
        let times = times.filter(|_| self.share_processor).unwrap_or_default();
        let mut times: Vec<(&Runner, u64)> = times.into_iter().collect();
        times.sort_by_key(|(_, ns)| std::cmp::Reverse(*ns));
        times
    }

    /// How long interrupts, and threads at least as urgent as the stage, had the processor during a delay [ns]: by the
    /// trace. A thread that is less urgent cannot have kept the stage from it.
    pub fn urgent_ns(&self, delay: &Delay) -> u64 {
        let last = self.samples.last();
        let own = last.map(|sample| sample.stages[delay.stage as usize].pid);
        let own_priority = self.slices.iter().find_map(|slice| match slice.runner {
            Runner::Thread { pid, priority, .. } if Some(pid) == own => Some(priority),
            _ => None,
        });
        let is_urgent = |runner: &Runner| match runner {
            Runner::Thread { pid, priority, .. } => {
                Some(*pid) != own && own_priority.is_some_and(|own| *priority <= own)
            }
            Runner::Interrupt { .. } => true,
            Runner::Idle => false,
        };
        let ran = self.ran(delay).into_iter();
        ran.filter(|(runner, _)| is_urgent(runner))
            .map(|(_, ns)| ns)
            .sum()
    }
}

fn lower_quartile(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values.get(values.len() / 4).copied().unwrap_or(0)
}
