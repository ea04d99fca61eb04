//! Why a deadline was missed: one class per miss, a pure function of the evidence.
//!
//! A rotor command is late because one stage of its tick was late: it got the processor too late, computed for too
//! long, or waited until its cut-off for an input that did not come. The culprit is the stage whose delay exceeds its
//! usual delay by most. The usual delay is the lower quartile of the surrounding ticks. The class follows from the
//! stage's counters and from the other stages' signs of life during that time. Where these are not enough, the class is
//! "the recorder cannot tell".

use model::role::{Role, STAGES};
use serde::{Deserialize, Serialize};

use crate::autopsy::evidence::{Delay, Scene, Suspect};

/// Why a deadline was missed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// Nothing ran on the loops' processor: every stage that was due was late, or the host says that it took time.
    HostStall,
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
            Self::WakeLate => "kernel wake-up late",
            Self::ComputedLong => "stage computed long",
            Self::UpstreamLate => "upstream late",
            Self::PageFault => "page fault",
            Self::Preempted => "preempted",
            Self::StoppedOrDead => "stage stopped or dead",
            Self::CannotTell => "recorder cannot tell",
        }
    }
}

/// What the evidence says of a miss.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Opinion {
    /// Why it was missed.
    pub class: Class,
    /// The stage that it was due to, where it was due to one.
    pub stage: Option<Role>,
    /// The evidence in words.
    pub evidence: String,
}

/// Share of a delay, in percent, that the counters must explain.
const EXPLAINS_PERCENT: u64 = 50;

/// Classes the missed deadline of a tick's command.
#[must_use]
pub fn classify(scene: &Scene<'_>, tick: u64) -> Opinion {
    let unknown = |evidence: &str| Opinion { class: Class::CannotTell, stage: None, evidence: evidence.into() };
    if scene.messages_lost() {
        return unknown("the recorder lost messages around it");
    }
    let suspects = scene.suspects(tick);
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
    let stage = (class != Class::HostStall && class != Class::CannotTell).then_some(worst.stage);
    Opinion { class, stage, evidence: format!("{}; {why}", worst.words()) }
}

/// The class of the delay that a miss is due to, with its evidence.
fn explain(scene: &Scene<'_>, suspect: &Suspect) -> (Class, String) {
    let usage = scene.usage(suspect);
    if usage.is_stopped {
        return (Class::StoppedOrDead, "its process was stopped".into());
    }
    if usage.is_dead {
        return (Class::StoppedOrDead, "its process has ended".into());
    }
    if usage.faults > 0 {
        return (Class::PageFault, format!("{} page faults", usage.faults));
    }
    if usage.waited_ns * 100 >= suspect.excess_ns * EXPLAINS_PERCENT && usage.waited_ns > 0 {
        let (us, switches) = (usage.waited_ns / 1000, usage.involuntary_switches);
        let words = format!("ready to run for {us} us without the processor, {switches} involuntary switches more");
        return (Class::Preempted, words);
    }
    if suspect.delay == Delay::Input {
        return (Class::UpstreamLate, "nothing says why".into());
    }
    let others = scene.others(suspect);
    let steal = scene.steal_grew(suspect);
    if suspect.delay == Delay::Compute && (others.ran || scene.recurs(suspect)) {
        let why = if others.ran { "others ran meanwhile" } else { "and in other ticks around" };
        return (Class::ComputedLong, why.into());
    }
    if !others.ran && steal {
        return (Class::HostStall, "nobody ran, and the host took time".into());
    }
    let ran_itself = suspect.delay == Delay::Compute && !scene.is_virtual;
    if !others.ran && others.were_due && !ran_itself {
        return (Class::HostStall, "nobody ran, although others were due".into());
    }
    match suspect.delay {
        Delay::Wake if others.ran => (Class::WakeLate, "others ran meanwhile".into()),
        // The host may have taken the processor without saying so.
        _ if scene.is_virtual => (Class::CannotTell, "on a virtual machine nothing else was due to show it".into()),
        Delay::Compute => (Class::ComputedLong, "nothing interrupted it".into()),
        Delay::Wake | Delay::Input => (Class::WakeLate, "nothing else was due meanwhile".into()),
    }
}

/// Stages of the loop by their place in [`STAGES`].
#[must_use]
pub fn index(role: Role) -> usize {
    (role as usize).min(STAGES.len() - 1)
}
