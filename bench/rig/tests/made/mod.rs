//! Evidence that is made up: a good flight around one tick, with changes.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;

use model::grid::Grid;
use model::role::Role;
use report::autopsy::classes::{Class, classify};
use report::autopsy::evidence::{CounterSample, Counters, Passage, Scene, TickPassages};
use report::autopsy::runners::Slice;
use report::autopsy::{AROUND_TICKS, Outage};

pub const T: u64 = 1_000_000;
pub const GRID: Grid = Grid { t0_ns: 50 * T, period_ns: T };
/// The tick that is missed in every case.
pub const MISSED: u64 = 32;
pub const US: u64 = 1_000;
/// Ticks of a case.
pub const WINDOW_TICKS: u64 = 2 * AROUND_TICKS;

/// What surrounds a miss: 64 ticks of a good flight, and samples each 10 ms, with what a case changes.
pub struct Made {
    pub traces: BTreeMap<u64, TickPassages>,
    pub samples: Vec<CounterSample>,
    pub slices: Vec<Slice>,
    pub is_virtual: bool,
    pub share_processor: bool,
}

/// A good tick: each stage wakes 10 us after the one before has sent, and computes for 5 us.
pub fn good(tick: u64) -> TickPassages {
    let begin = GRID.begin_of(tick);
    let at = |us: u64| Passage { receive_ns: begin + us * US, send_ns: begin + (us + 5) * US, is_fresh: true };
    [Some(at(20)), Some(at(35)), Some(at(50)), Some(at(65))]
}

pub fn made() -> Made {
    let stages: [Counters; 4] = std::array::from_fn(|i| Counters { pid: 100 + i as u64, ..Counters::default() });
    let sample = |i: u64| {
        // A loop waits for others on its processor in every tick: 30 us, and is switched out once.
        let stages = stages.map(|it| Counters {
            waited_ns: i * 300 * US,
            ran_ns: i * 50 * US,
            involuntary_switches: 10 * i,
            ..it
        });
        CounterSample { at_ns: GRID.begin_of(0) + i * 10 * T, stages, ..CounterSample::default() }
    };
    Made {
        traces: (0..WINDOW_TICKS).map(|tick| (tick, good(tick))).collect(),
        samples: (0..=7).map(sample).collect(),
        slices: Vec::new(),
        is_virtual: true,
        share_processor: true,
    }
}

impl Made {
    pub fn stage(&mut self, tick: u64, role: Role) -> &mut Passage {
        self.traces.get_mut(&tick).unwrap()[role as usize].as_mut().unwrap()
    }

    /// The stage is later by `us` in a tick, from waking on, and so is the rest of the chain.
    pub fn delays(&mut self, tick: u64, role: Role, us: u64) {
        for later in role as usize..4 {
            let passage = self.traces.get_mut(&tick).unwrap()[later].as_mut().unwrap();
            passage.receive_ns += us * US;
            passage.send_ns += us * US;
        }
    }

    /// The stage computes longer by `us` in a tick, and the rest of the chain is later.
    pub fn computes(&mut self, tick: u64, role: Role, us: u64) {
        self.stage(tick, role).send_ns += us * US;
        if role != Role::Mixer {
            let next = [Role::Outer, Role::Inner, Role::Mixer][role as usize];
            self.delays(tick, next, us);
        }
    }

    /// Nobody publishes anything in these ticks.
    pub fn silence(&mut self, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| {
            self.traces.remove(&tick);
        });
    }

    pub fn silence_of(&mut self, role: Role, ticks: std::ops::Range<u64>) {
        ticks.for_each(|tick| self.traces.get_mut(&tick).unwrap()[role as usize] = None);
    }

    /// Counts from a sample on: the fourth is the first one after the missed tick's begin.
    pub fn counts_from(&mut self, sample: usize, role: Role, count: impl Fn(&mut Counters)) {
        self.samples[sample..].iter_mut().for_each(|sample| count(&mut sample.stages[role as usize]));
    }

    pub fn class(&self) -> (Class, Option<Role>, String) {
        let stamps = self.traces.values().flatten().flatten().map(|passage| passage.send_ns);
        let is_whole = |tick: &u64| {
            self.traces.get(tick).is_some_and(|trace| trace.iter().all(|it| it.is_some_and(|it| it.is_fresh)))
        };
        let last = (MISSED..WINDOW_TICKS).take_while(|tick| *tick == MISSED || !is_whole(tick)).last().unwrap();
        let scene = Scene {
            grid: GRID,
            outage: Outage { first: MISSED, last, missed: 1 },
            traces: &self.traces,
            samples: &self.samples,
            slices: &self.slices,
            until_ns: stamps.max().unwrap(),
            is_virtual: self.is_virtual,
            share_processor: self.share_processor,
        };
        let opinion = classify(&scene);
        (opinion.class, opinion.stage, opinion.evidence)
    }
}

/// The plant wakes 2.1 ms late, and everybody else with it: two ticks are left out.
pub fn stall(made: &mut Made) {
    made.silence(MISSED..MISSED + 2);
    made.delays(MISSED + 2, Role::Plant, 100);
}
