//! Cause of an outage: that of its longest delay, where an observation of the delayed stage or of its processor says so.
//!
//! Without such an observation the cause is unknown, and the evidence says what was observed.

use crate::observations::{Delay, Life, Observations};
use crate::phrase::{list, surrounded};
use crate::processor_trace::RunnerTime;
use messages::role::{Role, STAGES};
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissCause {
    HostStall,
    Throttled,
    ComputedLong,
    MessageFault,
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
            Self::MessageFault => "message fault",
            Self::NotUsed => "message in time, not used",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::ReadyNotRun => "ready, not run",
            Self::StoppedOrDead => "stage stopped or dead",
            Self::CannotTell => "unknown",
        }
    }
}

/// Share of a delay that an observation must explain to name its cause [%].
const EXPLAINS_PERCENT: u64 = 50;

/// How much of a delay an observation explains [ns], and what was observed; nothing where nothing was.
type Observe = fn(&Observations<'_>, &Delay) -> Option<(u64, String)>;

const OBSERVATIONS: [(MissCause, Observe); 8] = [
    // A sample showed that the process was stopped, had ended, or was another one.
    (MissCause::StoppedOrDead, |seen, delay| {
        let is_stopped = seen.has_been(delay, Life::Stopped);
        let successor = seen.successor(delay);
        let is_dead = successor.is_some() || seen.has_been(delay, Life::Dead);
        let state = match (is_stopped, is_dead) {
            (true, true) => "was stopped and has ended",
            (false, true) => "has ended",
            (true, false) => "was stopped",
            (false, false) => return None,
        };
        let after = successor.map(|pid| format!(", and process {pid} took its place"));
        let after = after.unwrap_or_default();
        Some((delay.excess_ns, format!("its process {state}{after}")))
    }),
    // The stamps of the next stage say that it worked without a message that had been sent in time.
    (MissCause::NotUsed, |_, delay| {
        let before = STAGES.get((delay.stage as usize).checked_sub(1)?)?;
        let why = format!("it did not use the message that {before} had sent in time");
        delay.is_without_input.then_some((delay.excess_ns, why))
    }),
    (MissCause::Throttled, |seen, delay| {
        let us = seen.grown(delay, |it| it.throttled_us);
        let ms = us / 1000;
        let why = format!("a processor quota stopped its container for {ms} ms in all");
        Some((us * 1000, why))
    }),
    (MissCause::HostStall, |seen, delay| {
        let ns = seen.stolen_ns(delay);
        Some((ns, format!("the host took {} ms", ns / 1_000_000)))
    }),
    // How long page faults took is not known.
    (MissCause::PageFault, |seen, delay| {
        let faults = seen.grown(delay, |it| it.faults);
        (faults > 0).then(|| (delay.excess_ns, format!("{faults} page faults")))
    }),
    (MissCause::Preempted, |seen, delay| {
        let ns = seen.urgent_ns(delay);
        let who = "interrupts, or a thread at least as urgent, had the processor for";
        Some((ns, format!("{who} {} us", ns / 1000)))
    }),
    (MissCause::ReadyNotRun, |seen, delay| {
        let ns = seen.grown(delay, |it| it.waited_ns);
        let us = ns / 1000;
        let why = format!("ready to run for {us} us without the processor");
        Some((ns, why))
    }),
    (MissCause::ComputedLong, |seen, delay| {
        let ns = seen.grown(delay, |it| it.ran_ns);
        let why = format!("it ran for {} us more than usual", ns / 1000);
        delay.is_compute.then_some((ns, why))
    }),
];

#[derive(Clone, Debug, PartialEq)]
pub struct Attribution {
    pub class: MissCause,
    /// The longest delay of the outage; none where no stage is known to be late.
    pub delay: Option<Delay>,
    pub evidence: String,
    /// Who had the loops' processor in the delay, the longest first; empty without a trace.
    pub ran: Vec<RunnerTime>,
}

impl Attribution {
    fn unknown(evidence: &str) -> Self {
        Self {
            class: MissCause::CannotTell,
            delay: None,
            evidence: evidence.into(),
            ran: Vec::new(),
        }
    }

    pub fn of(seen: &Observations<'_>) -> Self {
        if seen.messages_lost {
            return Self::unknown("the recorder lost messages around it");
        }
        let delays = seen.delays();
        // Of those alike, the one of the first stage of the chain.
        let longest = delays.iter().rev().max_by_key(|it| it.excess_ns);
        // With a fault in most ticks, another cause takes a stage that had its inputs and was late for most of the outage.
        let had_inputs = delays.iter().filter(|it| !seen.is_withheld_from(it.stage));
        let late = had_inputs.rev().max_by_key(|it| it.excess_ns);
        let late = late.filter(|it| it.excess_ns > seen.grid.period_ns);
        let is_most = |ns: u64| ns * 100 >= seen.outage_ns() * EXPLAINS_PERCENT;
        if is_most(seen.withheld_ns()) && !late.is_some_and(|it| is_most(it.excess_ns)) {
            let late = late.map_or_else(String::new, |it| format!("; {}", it.words()));
            let evidence = format!("{}{late}", seen.withheld_words());
            return Self {
                class: MissCause::MessageFault,
                ..Self::unknown(&evidence)
            };
        }
        // A stage that computes long in most of the outage keeps others from the processor, which are then late for longer.
        let computed = |stage| {
            let delays = delays.iter();
            delays.filter(move |it| it.is_compute && it.stage == stage)
        };
        let longest_of = |stage| {
            Some((
                computed(stage).max_by_key(|it| it.excess_ns)?,
                computed(stage).count(),
            ))
        };
        let mut stages = STAGES.into_iter();
        let busy = stages.find(|it| is_most(computed(*it).map(|delay| delay.excess_ns).sum()));
        let longest = longest.map(|it| (it, delays.len()));
        let Some((delay, number)) = busy.and_then(longest_of).or(longest) else {
            return Self::unknown("no stage was later than usual");
        };
        let (class, why) = cause_of(seen, delay);
        let among = match number {
            1 => String::new(),
            number => format!(", the longest of {number} delays"),
        };
        let ran = seen.ran(delay).into_iter().take(RUNNERS);
        let ran = ran.map(|(runner, ns)| RunnerTime {
            who: runner.words(),
            us: ns as f64 / 1e3,
        });
        let ran: Vec<RunnerTime> = ran.collect();
        let longest = list(ran.iter().take(RUNNERS_IN_WORDS));
        let meanwhile = surrounded("; meanwhile ran ", &longest, "");
        Self {
            class,
            delay: Some(*delay),
            evidence: format!("{}{among}; {why}{meanwhile}", delay.words()),
            ran,
        }
    }

    /// The delayed stage; none where the host or a quota stopped all, or where no stage is known.
    pub fn stage(&self) -> Option<Role> {
        let is_of_all = matches!(self.class, MissCause::HostStall | MissCause::Throttled);
        self.delay.filter(|_| !is_of_all).map(|it| it.stage)
    }
}

/// The first observation of the table that explains enough of a delay; otherwise all that explain too little.
fn cause_of(seen: &Observations<'_>, delay: &Delay) -> (MissCause, String) {
    let mut too_little = Vec::new();
    for (cause, observe) in OBSERVATIONS {
        match observe(seen, delay) {
            Some((0, _)) | None => {}
            Some((ns, why)) if ns.saturating_mul(100) < delay.excess_ns * EXPLAINS_PERCENT => {
                too_little.push(why);
            }
            Some((_, why)) => return (cause, why),
        }
    }
    let why = match too_little.is_empty() {
        true => "nothing observed says why".into(),
        false => format!("{}: less than half of the delay", too_little.join(", ")),
    };
    (MissCause::CannotTell, why)
}

/// Programs kept of those that ran during a delay.
const RUNNERS: usize = 10;
const RUNNERS_IN_WORDS: usize = 3;
