//! Faults of messages, stages and the processor as processes have them, and those again as words.

use std::time::Duration;

use model::fault::Span;
use model::fault::live::{LiveFault, Trouble};
use report::injected::InjectedFault;

use crate::fault::message::{Inputs, MessageChange};
use crate::fault::processor::ProcessorChange;
use crate::fault::stage::{StageChange, StageKind};
use crate::fault::{At, Change, Fault, Lasting};

impl Change {
    /// What goes wrong in the loop, input by input, and whether it ends; nothing of a parameter.
    #[must_use]
    pub fn troubles(&self) -> Vec<(Trouble, bool)> {
        match self {
            Self::Parameter(_) => Vec::new(),
            Self::Messages(messages) => of_messages(messages, false),
            Self::Stage(stage) => vec![(of_stage(stage), false)],
            Self::Processor(processor) => vec![(processor.trouble(), false)],
            Self::Off(Lasting::Messages(messages)) => of_messages(messages, true),
            Self::Off(Lasting::Stage(stage)) => vec![(of_stage(stage), true)],
            Self::Off(Lasting::Processor(processor)) => vec![(processor.trouble(), true)],
        }
    }

    /// The same as faults of these ticks.
    pub fn faults(&self, asked: Span) -> impl Iterator<Item = LiveFault> {
        self.troubles().into_iter().map(move |(trouble, ends)| {
            let fault = LiveFault { trouble, ends, span: asked };
            LiveFault { span: fault.span_from(asked), ..fault }
        })
    }
}

fn of_messages(messages: &MessageChange, ends: bool) -> Vec<(Trouble, bool)> {
    let MessageChange { inputs, kind } = *messages;
    inputs.ports().map(|port| (Trouble::Messages { port, kind }, ends)).collect()
}

fn of_stage(stage: &StageChange) -> Trouble {
    let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    let role = stage.role;
    match stage.kind {
        StageKind::Late { least, most } => Trouble::Late { role, least_ns: ns(least), most_ns: ns(most) },
        StageKind::Stop(time) => Trouble::Stop { role, for_ns: ns(time) },
        StageKind::Kill => Trouble::Kill { role },
    }
}

/// What was injected, in the words and ticks that plan the same.
#[must_use]
pub fn planned_again(live: &[LiveFault]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut rest = live;
    while let Some(first) = rest.first() {
        let (change, taken) = joined(rest, first);
        let to = Some(At::Tick(first.span.to)).filter(|_| change.lasts() && first.span.to != Span::FOR_GOOD);
        faults.push(Fault { from: At::Tick(first.span.from), to, changes: vec![change] });
        rest = &rest[taken..];
    }
    faults
}

/// The same for the report.
#[must_use]
pub fn injected(live: &[LiveFault], period_s: f64) -> Vec<InjectedFault> {
    let told = |fault: Fault| {
        let to = fault.to.map(|to| to.tick(period_s));
        let what = fault.changes.iter().map(Change::to_string).collect::<Vec<_>>().join(",");
        InjectedFault::new(what, fault.from.tick(period_s), to, period_s).in_flight()
    };
    let mut ended = live.to_vec();
    for (place, end) in live.iter().enumerate().filter(|(_, fault)| fault.ends) {
        let is_meant = |fault: &&mut LiveFault| !fault.ends && fault.trouble.is_like(&end.trouble);
        ended[..place].iter_mut().filter(is_meant).for_each(|fault| fault.span.to = fault.span.to.min(end.span.from));
    }
    planned_again(&ended).into_iter().map(told).collect()
}

/// The first of some faults, with those behind it that are of the same topic's other inputs; and how many these are.
fn joined(faults: &[LiveFault], first: &LiveFault) -> (Change, usize) {
    let LiveFault { trouble, ends, .. } = *first;
    let off = |lasting: Lasting, change: Change| if ends { Change::Off(lasting) } else { change };
    let stage = |role, kind| {
        let stage = StageChange { role, kind };
        off(Lasting::Stage(stage), Change::Stage(stage))
    };
    let processor = |processor| off(Lasting::Processor(processor), Change::Processor(processor));
    let change = match trouble {
        Trouble::Messages { port, kind } => {
            let topic = Inputs::Topic(port);
            let same = |port| LiveFault { trouble: Trouble::Messages { port, kind }, ..*first };
            let all: Vec<LiveFault> = topic.ports().map(same).collect();
            let is_whole = faults.starts_with(&all);
            let inputs = if is_whole { topic } else { Inputs::One(port) };
            let messages = MessageChange { inputs, kind };
            let taken = if is_whole { all.len() } else { 1 };
            return (off(Lasting::Messages(messages), Change::Messages(messages)), taken);
        }
        Trouble::Late { role, least_ns, most_ns } => {
            let [least, most] = [least_ns, most_ns].map(Duration::from_nanos);
            stage(role, StageKind::Late { least, most })
        }
        Trouble::Stop { role, for_ns } => stage(role, StageKind::Stop(Duration::from_nanos(for_ns))),
        Trouble::Kill { role } => stage(role, StageKind::Kill),
        Trouble::Hog { priority } => processor(ProcessorChange::Hog(u8::try_from(priority).unwrap_or(u8::MAX))),
        Trouble::Load { share } => processor(ProcessorChange::Load(share)),
    };
    (change, 1)
}
