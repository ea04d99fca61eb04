//! Cause of an outage: the first of a table's observations that holds for the stage that was late.
//!
//! In each tick of an outage, the stamps show which stages woke later or computed longer than usual. The late stage is the
//! first of the chain with a delay longer than half of the outage, or else the one with more than half of all delays. A
//! cause is named only if an observation of that stage, or of its processor, proves it during its longest delay;
//! otherwise it is unknown.

use crate::observations::{Delay, Life, Observations};
use crate::processor_trace::RunnerTime;
use messages::role::{Role, STAGES};
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissCause {
    HostStall,
    Throttled,
    ComputedLong,
    NotUsed,
    PageFault,
    Preempted,
    ReadyNotRun,
    StoppedOrDead,
    CannotTell,
}

impl MissCause {
    pub const fn words(self) -> &'static str {
        match self {
            Self::HostStall => "host stall",
            Self::Throttled => "processor quota used up",
            Self::ComputedLong => "stage computed long",
            Self::NotUsed => "message in time, not used",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::ReadyNotRun => "ready, not run",
            Self::StoppedOrDead => "stage stopped or dead",
            Self::CannotTell => "unknown",
        }
    }
}

/// Share of a delay that an observation must cover [%].
const COVERS_PERCENT: u64 = 50;

/// Evidence of a cause, where it is there.
type Holds = fn(&Observations<'_>, &Delay) -> Option<String>;

/// Proof of each cause; the first that holds names it.
pub const OBSERVATIONS: [(MissCause, Holds); 9] = [
    // A sample showed that the process was stopped, had ended, or was another one.
    (MissCause::StoppedOrDead, |seen, delay| {
        let is_stopped = seen.has_been(delay, Life::Stopped);
        let successor = seen.successor(delay);
        let is_dead = successor.is_some() || seen.has_been(delay, Life::Dead);
        let after = successor.map(|pid| format!(", and process {pid} took its place"));
        let after = after.unwrap_or_default();
        match (is_stopped, is_dead) {
            (true, true) => Some(format!("its process was stopped and has ended{after}")),
            (false, true) => Some(format!("its process has ended{after}")),
            (true, false) => Some("its process was stopped".into()),
            (false, false) => None,
        }
    }),
    // The next stage's stamps say that it worked without a message that had been sent in time.
    (MissCause::NotUsed, |_, delay| {
        let before = STAGES.get((delay.stage as usize).checked_sub(1)?)?;
        let why = format!("it did not use the message that {before} had sent in time");
        delay.is_without_input.then_some(why)
    }),
    // A quota stopped the container for at least half of the delay.
    (MissCause::Throttled, |seen, delay| {
        let us = seen.grown(delay, |it| it.throttled_us);
        let ms = us / 1000;
        let why = format!("a processor quota stopped its container for {ms} ms in all");
        covers(us * 1000, delay).then_some(why)
    }),
    // At least half of the delay was stolen from the loops' processor.
    (MissCause::HostStall, |seen, delay| {
        let ns = seen.stolen_ns(delay);
        covers(ns, delay).then(|| format!("the host took {} ms", ns / 1_000_000))
    }),
    // The stage's page faults grew by more than usual.
    (MissCause::PageFault, |seen, delay| {
        let faults = seen.grown(delay, |it| it.faults);
        (faults > 0).then(|| format!("{faults} page faults"))
    }),
    // The trace shows interrupts, or threads at least as urgent, for at least half of the delay.
    (MissCause::Preempted, |seen, delay| {
        let why = "interrupts, or a thread at least as urgent, had the processor";
        covers(seen.urgent_ns(delay), delay).then(|| why.into())
    }),
    // The stage was switched out, and ready to run for at least half of the delay.
    (MissCause::Preempted, |seen, delay| {
        let switches = seen.grown(delay, |it| it.involuntary_switches);
        let ready = ready(seen, delay).filter(|_| switches > 0)?;
        Some(format!("{ready}, {switches} involuntary switches more"))
    }),
    // The stage was ready to run for at least half of the delay.
    (MissCause::ReadyNotRun, ready),
    // Its stamps say that it computed, and the kernel that it ran, for at least half of the delay more than usual.
    (MissCause::ComputedLong, |seen, delay| {
        let ns = seen.grown(delay, |it| it.ran_ns);
        let is_it = delay.is_compute && covers(ns, delay);
        is_it.then(|| format!("it ran for {} us more than usual", ns / 1000))
    }),
];

const fn covers(ns: u64, delay: &Delay) -> bool {
    ns > 0 && ns.saturating_mul(100) >= delay.excess_ns * COVERS_PERCENT
}

fn ready(seen: &Observations<'_>, delay: &Delay) -> Option<String> {
    let ns = seen.grown(delay, |it| it.waited_ns);
    let us = ns / 1000;
    covers(ns, delay).then(|| format!("ready to run for {us} us without the processor"))
}

#[derive(Clone, Debug, PartialEq)]
pub struct Attribution {
    pub class: MissCause,
    /// The stage that was late; none where the host or a quota stopped all, or where no stage is known.
    pub stage: Option<Role>,
    /// When the late stage was due, and its next sign of life [ns]; none where no stage is known.
    pub span_ns: Option<(u64, u64)>,
    pub evidence: String,
    /// Who had the loops' processor in the delay, the longest first; empty without a trace.
    pub ran: Vec<RunnerTime>,
}

pub fn classify(seen: &Observations<'_>) -> Attribution {
    let unknown = |evidence: &str| Attribution {
        class: MissCause::CannotTell,
        stage: None,
        span_ns: None,
        evidence: evidence.into(),
        ran: Vec::new(),
    };
    if seen.messages_lost {
        return unknown("the recorder lost messages around it");
    }
    let delays = seen.delays();
    if delays.is_empty() {
        return unknown("no stage was later than usual");
    }
    let time_ns = |delays: &[Delay]| delays.iter().map(|it| it.excess_ns).sum::<u64>();
    let outage_ns = (seen.outage.last + 1 - seen.outage.first) * seen.grid.period_ns;
    let fills = |it: &Delay| it.excess_ns * 2 > outage_ns;
    let is_filled = delays.iter().any(fills);
    let of_stage = |stage: Role| {
        let own = delays.iter().filter(|it| it.stage == stage).copied();
        let own: Vec<Delay> = own.collect();
        let is_late = match is_filled {
            true => own.iter().any(fills),
            false => time_ns(&own) * 2 > time_ns(&delays),
        };
        is_late.then_some(own)
    };
    let own = STAGES.into_iter().find_map(of_stage).unwrap_or_default();
    let Some(delay) = own.iter().max_by_key(|it| it.excess_ns) else {
        return unknown("several stages were late, and none accounts for most of the delay");
    };
    let mut observed = OBSERVATIONS.iter();
    let proof = observed.find_map(|(cause, holds)| Some((*cause, holds(seen, delay)?)));
    let nothing = || (MissCause::CannotTell, "nothing observed says why".into());
    let (class, why) = proof.unwrap_or_else(nothing);
    let is_of_all = matches!(class, MissCause::HostStall | MissCause::Throttled);
    let again = match own.len() {
        1 => String::new(),
        times => format!(" in the longest of {times} delays"),
    };
    let ran = seen.ran(delay).into_iter().take(RUNNERS);
    let ran = ran.map(|(runner, ns)| RunnerTime {
        who: runner.words(),
        us: ns as f64 / 1e3,
    });
    let ran: Vec<RunnerTime> = ran.collect();
    let longest = ran.iter().take(RUNNERS_IN_WORDS);
    let longest: Vec<String> = longest
        .map(|it| format!("{} {:.0} us", it.who, it.us))
        .collect();
    let meanwhile = match longest.is_empty() {
        true => String::new(),
        false => format!("; meanwhile ran {}", longest.join(", ")),
    };
    Attribution {
        class,
        stage: (!is_of_all).then_some(delay.stage),
        span_ns: Some((delay.from_ns, delay.to_ns)),
        evidence: format!("{}{again}; {why}{meanwhile}", delay.words()),
        ran,
    }
}

/// Programs kept of those that ran during a delay.
const RUNNERS: usize = 10;
const RUNNERS_IN_WORDS: usize = 3;
