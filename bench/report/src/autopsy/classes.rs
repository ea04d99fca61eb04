//! Why an outage came about: one class each, a pure function of the evidence.
//!
//! An outage begins with one stage of a tick that was late: it got the processor too late, computed for too long, or
//! did not send what the next stage waited for. The culprit is the stage whose delay exceeds its usual delay by most
//! in the first tick. The usual delay is the lower quartile of the ticks around. The class follows from the stage's
//! counters, from its processor's, and from the other stages' signs of life, from when it was due to its next sign of
//! life. A cause that nothing was seen of is not named: the class then is "the recorder cannot tell".

use model::role::{Role, STAGES};
use serde::{Deserialize, Serialize};

use crate::autopsy::evidence::{Delay, Scene, Suspect};

/// Why an outage came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// The host took the processor: it accounts for at least half of the delay.
    HostStall,
    /// Nothing was seen to run on the loops' processor, although stages were due; nobody says why.
    ProcessorStalled,
    /// The kernel gave a stage the processor late, while others ran.
    WakeLate,
    /// A stage computed longer than usual.
    ComputedLong,
    /// A stage waited until its cut-off for an input whose lateness nothing explains.
    UpstreamLate,
    /// The stage had page faults.
    PageFault,
    /// The stage wanted to run, and somebody else had the processor.
    Preempted,
    /// The stage wanted to run and did not, and nobody was seen to run instead.
    ReadyNotRun,
    /// The stage was stopped by a signal, or its process has ended.
    StoppedOrDead,
    /// The evidence does not decide it.
    CannotTell,
}

impl Class {
    /// In words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::HostStall => "host stall",
            Self::ProcessorStalled => "processor stalled",
            Self::WakeLate => "kernel wake-up late",
            Self::ComputedLong => "stage computed long",
            Self::UpstreamLate => "upstream late",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::ReadyNotRun => "ready, not run",
            Self::StoppedOrDead => "stage stopped or dead",
            Self::CannotTell => "recorder cannot tell",
        }
    }

    /// Whether it is a stage's: others are the machine's, or not known.
    const fn is_of_a_stage(self) -> bool {
        !matches!(self, Self::HostStall | Self::ProcessorStalled | Self::CannotTell)
    }
}

/// What the evidence says of an outage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Opinion {
    /// Why it came about.
    pub class: Class,
    /// The stage that it was due to, where it was due to one.
    pub stage: Option<Role>,
    /// From when a stage was due to its next sign of life [ns]; 0 where no stage is known.
    pub delay_ns: u64,
    /// The evidence in words.
    pub evidence: String,
}

/// Share of a delay, in percent, that the counters must explain.
const EXPLAINS_PERCENT: u64 = 50;

/// Classes an outage.
#[must_use]
pub fn classify(scene: &Scene<'_>) -> Opinion {
    let unknown =
        |evidence: &str| Opinion { class: Class::CannotTell, stage: None, delay_ns: 0, evidence: evidence.into() };
    if scene.messages_lost() {
        return unknown("the recorder lost messages around it");
    }
    let suspects = scene.suspects(scene.outage.first);
    let (inputs, own): (Vec<&Suspect>, Vec<&Suspect>) = suspects.iter().partition(|it| it.delay == Delay::Input);
    let share_ns = |suspect: &&&Suspect| suspect.share_ns;
    let worst = match (own.iter().max_by_key(share_ns), inputs.iter().max_by_key(share_ns)) {
        // A stage that was waited for is late with something, unless its message was not used.
        (Some(own), Some(input)) if own.share_ns * 100 < input.share_ns * EXPLAINS_PERCENT => input,
        (Some(own), _) => own,
        (None, Some(input)) => input,
        (None, None) => return unknown("no stage was later than usual"),
    };
    let all_ns: u64 = own.iter().map(|suspect| suspect.share_ns).sum();
    if worst.share_ns * 100 < all_ns * EXPLAINS_PERCENT {
        return unknown("several stages were late, none of them by most of it");
    }
    let (class, why) = explain(scene, worst);
    let stage = class.is_of_a_stage().then_some(worst.stage);
    let delay_ns = worst.to_ns - worst.from_ns;
    Opinion { class, stage, delay_ns, evidence: format!("{}; {why}", worst.words()) }
}

/// The class of the delay that an outage began with, with its evidence.
fn explain(scene: &Scene<'_>, suspect: &Suspect) -> (Class, String) {
    let usage = scene.usage(suspect);
    let explains = |ns: u64| ns > 0 && ns * 100 >= suspect.excess_ns * EXPLAINS_PERCENT;
    if usage.is_stopped {
        return (Class::StoppedOrDead, "its process was stopped".into());
    }
    if usage.is_dead {
        return (Class::StoppedOrDead, "its process has ended".into());
    }
    let (processor, others) = (scene.processor(suspect), scene.others(suspect));
    if explains(processor.stolen_ns) {
        return (Class::HostStall, format!("the host took {} ms", processor.stolen_ns / 1_000_000));
    }
    if usage.faults > 0 {
        return (Class::PageFault, format!("{} page faults", usage.faults));
    }
    if explains(usage.waited_ns) {
        let (us, switches) = (usage.waited_ns / 1000, usage.involuntary_switches);
        let ready = format!("ready to run for {us} us without the processor");
        if switches > 0 {
            return (Class::Preempted, format!("{ready}, {switches} involuntary switches more"));
        }
        if others.is_some_and(|others| others.ran) {
            return (Class::Preempted, format!("{ready}, other stages ran meanwhile"));
        }
        if explains(processor.busy_ns) {
            return (Class::Preempted, format!("{ready}, which was busy for {} ms", processor.busy_ns / 1_000_000));
        }
        return (Class::ReadyNotRun, format!("{ready}, and nobody was seen to run"));
    }
    if suspect.delay == Delay::Input {
        return (Class::UpstreamLate, "nothing says why".into());
    }
    if suspect.delay == Delay::Compute {
        if explains(usage.ran_ns) {
            return (Class::ComputedLong, format!("it ran for {} us more than usual", usage.ran_ns / 1000));
        }
        if others.is_some_and(|others| others.ran) {
            return (Class::ComputedLong, "others ran meanwhile".into());
        }
        if scene.recurs(suspect) {
            return (Class::ComputedLong, "and in other ticks around".into());
        }
    }
    let Some(others) = others else {
        return (Class::CannotTell, "the loops do not share a processor, so that nothing else shows it".into());
    };
    if !others.ran && others.were_due && !explains(processor.busy_ns) {
        return (Class::ProcessorStalled, "nobody ran, although others were due".into());
    }
    match suspect.delay {
        Delay::Wake if others.ran => (Class::WakeLate, "others ran meanwhile".into()),
        // The host may have taken the processor without saying so.
        _ if scene.is_virtual => {
            (Class::CannotTell, "nothing else was due, to show whether a hypervisor took the processor".into())
        }
        Delay::Compute => (Class::ComputedLong, "nothing interrupted it".into()),
        Delay::Wake | Delay::Input => (Class::WakeLate, "nothing else was due meanwhile".into()),
    }
}

/// Stages of the loop by their place in [`STAGES`].
#[must_use]
pub fn index(role: Role) -> usize {
    (role as usize).min(STAGES.len() - 1)
}
