//! The delays of an outage's ticks: who was late, with what, and by how much more than usual.

use model::role::{Role, STAGES};

use crate::autopsy::evidence::{Passage, Scene, TickPassages};

/// What a stage was late with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delay {
    /// With its work of an earlier tick, in which it still was when it, or another stage on its processor, was due.
    Busy,
    /// With getting the processor after its timer, its input or its cut-off had come.
    Wake,
    /// With computing.
    Compute,
    /// With its output, so that the next stage waited until its cut-off.
    Input,
    /// With nothing: the next stage waited for an output that had been sent in time.
    Unused,
}

impl Delay {
    /// Whether it is the next stage that tells of it.
    #[must_use]
    pub const fn is_of_input(self) -> bool {
        matches!(self, Self::Input | Self::Unused)
    }
}

/// A delay that was longer than usual.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suspect {
    /// The late stage.
    pub stage: Role,
    /// What it was late with.
    pub delay: Delay,
    /// From when on it was late [ns].
    pub from_ns: u64,
    /// Until when [ns].
    pub to_ns: u64,
    /// How much longer than usual [ns].
    pub excess_ns: u64,
    /// How much of that certainly lies in the tick [ns]. A stage that published nothing for it may have been back from
    /// the beginning of the next tick on, when it was too late to publish.
    pub share_ns: u64,
}

impl Suspect {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        let us = self.excess_ns / 1000;
        match self.delay {
            Delay::Busy => format!("{} was at work for {us} us in which a stage was due", self.stage),
            Delay::Wake => format!("{} woke {us} us later than usual", self.stage),
            Delay::Compute => format!("{} computed {us} us longer than usual", self.stage),
            Delay::Input => format!("{} was waited for {us} us longer than usual", self.stage),
            Delay::Unused => format!("what {} had sent in time was waited for {us} us longer than usual", self.stage),
        }
    }
}

/// What is usual among values: their lower quartile, because a disturbance that lasts must not pass for the usual.
pub(super) fn usual_of(mut values: Vec<u64>) -> u64 {
    values.sort_unstable();
    values.get(values.len() / 4).copied().unwrap_or(0)
}

impl Scene<'_> {
    /// The delays in a tick that were longer than usual, in the order of the chain.
    #[must_use]
    pub fn suspects(&self, tick: u64) -> Vec<Suspect> {
        let begin_ns = self.grid.begin_of(tick);
        let trace = self.traces.get(&tick).copied().unwrap_or_default();
        let mut suspects = Vec::new();
        for (i, stage) in STAGES.into_iter().enumerate() {
            let before = i.checked_sub(1);
            let sent_ns = before.and_then(|before| trace[before]).map(|passage| passage.send_ns);
            let cut_off_ns = self.grid.cut_off_of(stage, tick);
            let came_in_time = i == 0 || sent_ns.is_some_and(|ns| ns <= cut_off_ns);
            let is_fresh = trace[i].map_or(came_in_time, |passage| passage.is_fresh);
            let hop = |trace: &TickPassages| {
                let (own, sent) = (trace[i]?, trace[before?]?);
                own.is_fresh.then(|| own.receive_ns.saturating_sub(sent.send_ns))
            };
            let (due_ns, usual_ns) = match sent_ns {
                _ if i == 0 => (begin_ns, self.usual(|k, trace| Some(trace[0]?.receive_ns.saturating_sub(k)))),
                Some(sent_ns) if is_fresh => (sent_ns, self.usual(|_, trace| hop(trace))),
                _ => (cut_off_ns, 0),
            };
            if let (false, Some(before)) = (is_fresh, before) {
                let usual_ns = self.usual(|begin, trace| Some(trace[before]?.send_ns.saturating_sub(begin)));
                let excess_ns = (cut_off_ns - begin_ns).saturating_sub(usual_ns);
                let came_ns = trace[before].map_or_else(|| self.next_sign_of(before, tick), |passage| passage.send_ns);
                let is_in_time = |sent_ns: u64| sent_ns + self.usual(|_, trace| hop(trace)) <= cut_off_ns;
                suspects.push(Suspect {
                    stage: STAGES[before],
                    delay: if sent_ns.is_some_and(is_in_time) { Delay::Unused } else { Delay::Input },
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
            if let Some(earlier) = busy {
                suspects.push(Suspect {
                    stage,
                    delay: Delay::Busy,
                    from_ns: earlier.receive_ns,
                    to_ns: earlier.send_ns,
                    excess_ns: earlier.send_ns - due_ns,
                    share_ns: earlier.send_ns.min(self.grid.begin_of(tick + 1)).saturating_sub(due_ns),
                });
            }
            let due_ns = busy.map_or(due_ns, |earlier| earlier.send_ns);
            let receive_ns = trace[i].map_or_else(|| self.next_sign_of(i, tick), |passage| passage.receive_ns);
            let sure_ns = trace[i].map_or(self.grid.begin_of(tick + 1), |passage| passage.receive_ns);
            suspects.push(Suspect {
                stage,
                delay: Delay::Wake,
                from_ns: due_ns,
                to_ns: receive_ns.max(due_ns),
                excess_ns: receive_ns.saturating_sub(due_ns).saturating_sub(usual_ns),
                share_ns: sure_ns.saturating_sub(due_ns).saturating_sub(usual_ns),
            });
            if let Some(passage) = trace[i] {
                let computed_ns = passage.send_ns.saturating_sub(passage.receive_ns);
                let excess_ns = computed_ns.saturating_sub(self.compute(i));
                suspects.push(Suspect {
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
    #[must_use]
    pub fn at_work_instead(&self, late: &Suspect) -> Option<Suspect> {
        if late.delay != Delay::Wake || !self.share_processor {
            return None;
        }
        let works = self.traces.values().flat_map(|trace| STAGES.into_iter().zip(*trace));
        let works = works.filter_map(|(stage, passage)| {
            let passage = passage.filter(|_| stage != late.stage)?;
            let shared_ns = passage.send_ns.min(late.to_ns).saturating_sub(passage.receive_ns.max(late.from_ns));
            Some((shared_ns, stage, passage))
        });
        let (shared_ns, stage, Passage { receive_ns, send_ns, .. }) = works.max_by_key(|(shared_ns, ..)| *shared_ns)?;
        (shared_ns * 2 > late.excess_ns).then_some(Suspect {
            stage,
            delay: Delay::Busy,
            from_ns: receive_ns,
            to_ns: send_ns,
            excess_ns: shared_ns,
            share_ns: shared_ns,
        })
    }

    /// The work of an earlier tick in which a stage was at an instant.
    fn at_work(&self, stage: usize, at_ns: u64, tick: u64) -> Option<Passage> {
        let earlier = self.traces.range(..tick).rev().find_map(|(_, trace)| trace[stage])?;
        (earlier.receive_ns < at_ns && at_ns < earlier.send_ns).then_some(earlier)
    }

    /// What a duration usually is in the ticks around; `pick` is given the beginning of the tick.
    fn usual(&self, pick: impl Fn(u64, &TickPassages) -> Option<u64>) -> u64 {
        let others = self.traces.iter().filter(|(tick, _)| !(self.outage.first..=self.outage.last).contains(tick));
        usual_of(others.filter_map(|(other, trace)| pick(self.grid.begin_of(*other), trace)).collect())
    }

    fn compute(&self, stage: usize) -> u64 {
        self.usual(|_, trace| {
            let passage = trace[stage]?;
            Some(passage.send_ns.saturating_sub(passage.receive_ns))
        })
    }

    /// When a stage woke for the first time after a tick that it left out [ns].
    fn next_sign_of(&self, stage: usize, tick: u64) -> u64 {
        let later = self.traces.range(tick + 1..).find_map(|(_, trace)| trace[stage]);
        later.map_or(self.until_ns, |passage| passage.receive_ns)
    }
}
