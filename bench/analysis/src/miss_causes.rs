//! Why an outage came about: one class each, a pure function of the evidence.
//!
//! An outage is a row of delays: a stage of a tick got the processor too late, computed for too long, or did not send
//! what the next stage waited for; the next delay is looked for when that stage is back. In each such tick the culprit
//! is the stage whose delay exceeds its usual delay by most; the usual delay is the lower quartile of the ticks around.
//! The culprit of the outage is the one with most of the time. The class follows from the stage's counters, from its
//! processor's, and from the other stages' signs of life in its longest delay, from when it was due to its next sign
//! of life. A cause is named only if there is evidence for it: the class then is "the recorder cannot tell".

use crate::candidate_causes::{CandidateCause, Delay, TimingWindow};
use crate::processor_trace::{Runner, RunnerTime};
use messages::role::{Role, STAGES};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MissCause {
    /// The host took the processor: it accounts for at least half of the delay.
    HostStall,
    /// Nothing was seen to run on the loops' processor although stages were due; the cause is unknown.
    ProcessorStalled,
    /// A stage woke late while others ran, and nothing says why.
    WakeLate,
    ComputedLong,
    /// A stage waited until its cut-off for an input whose lateness nothing explains.
    UpstreamLate,
    /// A stage waited until its cut-off for a message that had been sent in time.
    NotUsed,
    PageFault,
    /// The stage was ready, and another program had the processor.
    Preempted,
    /// The stage was ready and did not run, and no other program was seen running.
    ReadyNotRun,
    /// The stage was stopped by a signal, or its process has ended.
    StoppedOrDead,
    CannotTell,
}

impl MissCause {
    pub const fn words(self) -> &'static str {
        match self {
            Self::HostStall => "host stall",
            Self::ProcessorStalled => "processor stalled",
            Self::WakeLate => "woke late, nothing says why",
            Self::ComputedLong => "stage computed long",
            Self::UpstreamLate => "upstream late",
            Self::NotUsed => "message in time, not used",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::ReadyNotRun => "ready, not run",
            Self::StoppedOrDead => "stage stopped or dead",
            Self::CannotTell => "recorder cannot tell",
        }
    }

    /// Whether the stage wanted to run and the machine did not let it.
    pub const fn is_of_the_machine(self) -> bool {
        matches!(
            self,
            Self::HostStall
                | Self::ProcessorStalled
                | Self::WakeLate
                | Self::Preempted
                | Self::ReadyNotRun
        )
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Attribution {
    pub class: MissCause,
    /// The stage that it was due to, where it was due to one.
    pub stage: Option<Role>,
    /// When the late stage was due, and its next sign of life [ns]; none where no stage is known.
    pub span_ns: Option<(u64, u64)>,
    pub evidence: String,
    /// Who had the loops' processor in the delay, the longest first; empty without a trace.
    pub ran: Vec<RunnerTime>,
}

/// Share of a delay, in percent, that the counters must explain.
const EXPLAINS_PERCENT: u64 = 50;

pub fn classify(scene: &TimingWindow<'_>) -> Attribution {
    let unknown = |evidence: &str| Attribution {
        class: MissCause::CannotTell,
        stage: None,
        span_ns: None,
        evidence: evidence.into(),
        ran: Vec::new(),
    };
    if scene.messages_lost() {
        return unknown("the recorder lost messages around it");
    }
    let Some((suspect, times)) = longest(&delays(scene), scene.grid.period_ns) else {
        return unknown("no stage was later than usual");
    };
    let Some(suspect) = suspect else {
        return unknown("several stages were late, and none accounts for most of the delay");
    };
    let suspect = scene.at_work_instead(&suspect).unwrap_or(suspect);
    let (class, why) = explain(scene, &suspect);
    // Other causes are the machine's, or not known.
    let is_of_a_stage = !matches!(
        class,
        MissCause::HostStall | MissCause::ProcessorStalled | MissCause::CannotTell
    );
    let stage = is_of_a_stage.then_some(suspect.stage);
    let span_ns = Some((suspect.from_ns, suspect.to_ns));
    let again = match times {
        0 | 1 => String::new(),
        _ => format!(" in the longest of {times} delays"),
    };
    let ran = scene.runner_times(&suspect).unwrap_or_default().into_iter();
    let ran = ran.take(RUNNERS).map(|(runner, ns)| RunnerTime {
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
        stage,
        span_ns,
        evidence: format!("{}{again}; {why}{meanwhile}", suspect.words()),
        ran,
    }
}

/// Programs kept of those that ran during a delay.
const RUNNERS: usize = 10;
const RUNNERS_IN_WORDS: usize = 3;

/// Delays of an outage that are looked at.
const DELAYS: usize = 64;

/// The delays of an outage, one after the other; nothing for a tick in which none of several was most of it.
fn delays(scene: &TimingWindow<'_>) -> Vec<Option<CandidateCause>> {
    let (mut tick, mut delays) = (scene.outage.first, Vec::new());
    while tick <= scene.outage.last && delays.len() < DELAYS {
        let suspects = scene.suspects(tick);
        tick += 1;
        if suspects.is_empty() {
            continue;
        }
        let worst = worst_of(&suspects);
        if let Some(suspect) = worst {
            tick = tick.max(scene.grid.tick_at(suspect.to_ns));
        }
        delays.push(worst);
    }
    delays
}

fn worst_of(suspects: &[CandidateCause]) -> Option<CandidateCause> {
    let (inputs, own): (Vec<&CandidateCause>, Vec<&CandidateCause>) = suspects
        .iter()
        .partition(|it| matches!(it.delay, Delay::Input | Delay::Unused));
    fn most<'a>(all: &[&'a CandidateCause]) -> Option<&'a CandidateCause> {
        all.iter().copied().max_by_key(|it| it.share_ns)
    }
    let worst = match (most(&own), most(&inputs)) {
        // A stage that was waited for is late with something, unless its message was not used.
        (Some(own), Some(input)) if own.share_ns * 100 < input.share_ns * EXPLAINS_PERCENT => input,
        (Some(own), _) => own,
        (None, input) => input?,
    };
    let all_ns: u64 = own.iter().map(|suspect| suspect.share_ns).sum();
    (worst.share_ns * 100 >= all_ns * EXPLAINS_PERCENT).then_some(*worst)
}

/// The longest delay of the stage that most of the time is due to, with how many it had; nothing where there is no
/// such stage, and nothing at all where there are no delays.
fn longest(
    delays: &[Option<CandidateCause>],
    period_ns: u64,
) -> Option<(Option<CandidateCause>, usize)> {
    let length_ns = |suspect: &CandidateCause| suspect.to_ns - suspect.from_ns;
    let mut culprits = BTreeMap::<Role, Vec<CandidateCause>>::new();
    for suspect in delays.iter().flatten() {
        culprits.entry(suspect.stage).or_default().push(*suspect);
    }
    let time_ns = |delays: &Vec<CandidateCause>| delays.iter().map(length_ns).sum::<u64>();
    let undecided_ns = delays.iter().filter(|delay| delay.is_none()).count() as u64 * period_ns;
    let all_ns = undecided_ns + culprits.values().map(time_ns).sum::<u64>();
    let Some(most) = culprits.values().max_by_key(|delays| time_ns(delays)) else {
        return (!delays.is_empty()).then_some((None, 0));
    };
    let is_most = time_ns(most) * 100 >= all_ns * EXPLAINS_PERCENT;
    let longest = most.iter().copied().max_by_key(length_ns);
    Some((longest.filter(|_| is_most), most.len()))
}

fn explain(scene: &TimingWindow<'_>, suspect: &CandidateCause) -> (MissCause, String) {
    use MissCause::*;
    let because = |cause: MissCause, why: &str| (cause, why.to_owned());
    if suspect.delay == Delay::Unused {
        let why = "it was sent in time, and the next stage worked without it: why is not known";
        return because(NotUsed, why);
    }
    let usage = scene.usage(suspect);
    let explains = |ns: u64| ns > 0 && ns * 100 >= suspect.excess_ns * EXPLAINS_PERCENT;
    if usage.is_dead {
        let before = if usage.is_stopped {
            "was stopped and "
        } else {
            ""
        };
        let after = usage
            .successor
            .map(|pid| format!(", and process {pid} took its place"));
        let after = after.unwrap_or_default();
        return (
            StoppedOrDead,
            format!("its process {before}has ended{after}"),
        );
    }
    if usage.is_stopped {
        return because(StoppedOrDead, "its process was stopped");
    }
    let others = scene.others(suspect);
    let others_ran = others.is_some_and(|others| others.ran);
    if explains(usage.stolen_ns) {
        let ms = usage.stolen_ns / 1_000_000;
        return (HostStall, format!("the host took {ms} ms"));
    }
    if usage.faults > 0 {
        return (PageFault, format!("{} page faults", usage.faults));
    }
    if suspect.delay != Delay::Input && explains(urgent_ns(scene, suspect)) {
        let why = "interrupts, or a thread at least as urgent, had the processor";
        return because(Preempted, why);
    }
    if explains(usage.waited_ns) {
        let (us, switches) = (usage.waited_ns / 1000, usage.involuntary_switches);
        let ready = format!("ready to run for {us} us without the processor");
        if switches > 0 {
            return (
                Preempted,
                format!("{ready}, {switches} involuntary switches more"),
            );
        }
        if others_ran {
            return (Preempted, format!("{ready}, other stages ran meanwhile"));
        }
        // When the host stops a virtual machine, the thread on its processor appears to run.
        if explains(usage.busy_ns) && !scene.is_virtual {
            let ms = usage.busy_ns / 1_000_000;
            return (Preempted, format!("{ready}, which was busy for {ms} ms"));
        }
        let blocking = scene.runner_times(suspect).map(|_| " that could delay it");
        let blocking = blocking.unwrap_or_default();
        return (
            ReadyNotRun,
            format!("{ready}, and no other program{blocking} was seen running"),
        );
    }
    if suspect.delay == Delay::Input {
        return because(UpstreamLate, "nothing says why");
    }
    let is_computing = matches!(suspect.delay, Delay::Compute | Delay::Busy);
    if is_computing && explains(usage.ran_ns) {
        let us = usage.ran_ns / 1000;
        return (ComputedLong, format!("it ran for {us} us more than usual"));
    }
    if is_computing && others_ran {
        return because(ComputedLong, "others ran meanwhile");
    }
    if is_computing && scene.recurs(suspect) {
        return because(ComputedLong, "and in other ticks around");
    }
    let Some(others) = others else {
        let why = "the loops do not share a processor, so that nothing else shows it";
        return because(CannotTell, why);
    };
    let none_ran = !others.ran && others.were_due;
    match suspect.delay {
        _ if none_ran && explains(usage.busy_ns) => {
            let why = "no stage ran, although others were due, and the processor was busy";
            because(CannotTell, why)
        }
        _ if none_ran => because(ProcessorStalled, "no stage ran, although others were due"),
        Delay::Wake if others.ran => because(WakeLate, "others ran meanwhile"),
        // The host may have taken the processor without saying so.
        _ if scene.is_virtual => {
            let why = "on a virtual machine, or what may be one, nothing else was due to show it";
            because(CannotTell, why)
        }
        _ if is_computing => because(ComputedLong, "nothing interrupted it"),
        _ => because(WakeLate, "nothing else was due meanwhile"),
    }
}

/// How long interrupts, and threads that may keep a stage from the processor, had it in a delay [ns]: by the trace.
///
/// Who is less urgent than a stage that is ready cannot have kept it from the processor: the kernel did not switch, or
/// a virtual machine stood still with that thread on its processor.
fn urgent_ns(scene: &TimingWindow<'_>, suspect: &CandidateCause) -> u64 {
    let last = scene.samples.last();
    let own = last.map(|sample| sample.stages[suspect.stage as usize].pid);
    let own_priority = scene.slices.iter().find_map(|slice| match slice.runner {
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
    let ran = scene.runner_times(suspect).unwrap_or_default().into_iter();
    ran.filter(|(runner, _)| is_urgent(runner))
        .map(|(_, ns)| ns)
        .sum()
}

/// Stages of the loop by their place in [`STAGES`].
pub fn index(role: Role) -> usize {
    (role as usize).min(STAGES.len() - 1)
}
