//! The faults of a flight in its ticks: swaps, faults of messages, outages and lateness of stages, and what the
//! supervisor does to processes.

use std::time::Duration;

use crate::live::{
    Acts, FaultKind, LiveFault, LoopFaults, MAX_LIVE_FAULTS, NOTICE_TICKS, RESTART_NS, late_share,
};
use crate::swap::Swap;
use crate::{FaultRefusal, MAX_MESSAGE_FAULTS, Span};
use messages::parameters::Airframe;
use messages::role::Role;

use crate::grammar::{Change, Fault, FaultError, typed};

/// How long a stage that was killed takes until it works again.
pub const RESTART: Duration = Duration::from_nanos(RESTART_NS);

#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    pub swaps: Vec<Swap>,
    /// Those that stages inject themselves: of messages, and lateness.
    pub loops: LoopFaults,
    /// What a supervisor does to processes on the clock: stop, kill, keep the processor busy.
    pub acts: Vec<LiveFault>,
    /// The same, and lateness, by the rules that also hold in flight.
    pub table: Acts,
    /// Those of stages, in simulated ticks.
    pub stages: Vec<StageFault>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageFault {
    pub role: Role,
    pub kind: StageTicks,
    pub span: Span,
}

/// What a fault does to the ticks of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StageTicks {
    Out,
    /// The stage misses them, and then starts again.
    Anew,
    /// Each takes this many periods longer.
    Late {
        least: f64,
        most: f64,
    },
}

/// What becomes of a tick that a late stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lateness {
    /// Ticks by which its output is late.
    pub output: u64,
    /// Ticks until it can run the next one; 1 misses none.
    pub next: u64,
}

impl Lateness {
    pub const NONE: Self = Self { output: 0, next: 1 };
}

impl StageTicks {
    /// What becomes of a tick, by the seed of the flight.
    pub fn lateness(self, role: Role, seed: u64, tick: u64) -> Lateness {
        let Self::Late { least, most } = self else {
            return Lateness::NONE;
        };
        let periods = least + (most - least) * late_share(role, seed, tick);
        // A whole number of periods is reached in the tick that then begins.
        Lateness {
            output: periods.floor() as u64,
            next: (periods.ceil() as u64).max(1),
        }
    }
}

impl Planned {
    /// The faults of a flight with an airframe, ticks of `period_s` [s] and a seed.
    pub fn new(
        faults: &[Fault],
        period_s: f64,
        airframe: &Airframe,
        seed: u64,
    ) -> Result<Self, FaultError> {
        let mut planned = Self {
            swaps: Vec::new(),
            loops: LoopFaults::none(seed),
            acts: Vec::new(),
            table: Acts::none((period_s * 1e9).round() as u64),
            stages: Vec::new(),
        };
        for fault in faults {
            let span = fault.span(period_s)?;
            planned.swaps.extend(fault.swap(period_s, airframe)?);
            for change in &fault.changes {
                for fault in change.faults(span) {
                    planned.take(&fault, period_s)?;
                }
            }
        }
        let begun = planned.table.begun();
        planned.stages = begun.filter_map(|it| stage_fault(it, period_s)).collect();
        Ok(planned)
    }

    fn take(&mut self, fault: &LiveFault, period_s: f64) -> Result<(), FaultError> {
        let taken = self.loops.take(fault).and_then(|()| self.table.take(fault));
        taken.map_err(|reason| refused(reason, fault, period_s))?;
        match fault.kind {
            FaultKind::Messages { .. } | FaultKind::Late { .. } | FaultKind::Switch { .. } => {}
            _ => self.acts.push(*fault),
        }
        Ok(())
    }

    /// Whether neither messages nor stages have faults.
    pub fn has_no_loop_faults(&self) -> bool {
        self.loops.messages.is_empty() && self.stages.is_empty()
    }
}

/// What a fault does to its stage in simulated ticks; `None` if other channels fly meanwhile, or no stage has it.
fn stage_fault(fault: &LiveFault, period_s: f64) -> Option<StageFault> {
    let span = fault.span;
    let periods = |ns| periods(Duration::from_nanos(ns).as_secs_f64(), period_s);
    let out = |periods: f64| {
        let ticks = periods.floor() as u64;
        Span::new(span.from, span.from.saturating_add(ticks))
    };
    let (kind, span) = match fault.kind {
        FaultKind::Late { range_ns, .. } => {
            let [least, most] = range_ns.map(periods);
            (StageTicks::Late { least, most }, span)
        }
        FaultKind::Stop { for_ns, .. } => (StageTicks::Out, out(periods(for_ns))),
        FaultKind::Kill { .. } => (StageTicks::Anew, out(periods(RESTART_NS).max(1.0))),
        _ => return None,
    };
    let role = fault.kind.role()?;
    let is_alone = fault.kind.channel().is_none();
    is_alone.then_some(StageFault { role, kind, span })
}

/// Why a fault is not taken, with its name, in a flight with ticks of `period_s` [s].
pub fn refused(reason: FaultRefusal, fault: &LiveFault, period_s: f64) -> FaultError {
    let what = Change::joined(&[*fault], fault).0.what();
    FaultError::fault(match (reason, fault.kind) {
        (FaultRefusal::NoRoom, _) => format!(
            "there are more than {MAX_MESSAGE_FAULTS} faults of messages, counted by input, or of `late`, or more than \
             {MAX_LIVE_FAULTS} of processes: leave some out"
        ),
        (FaultRefusal::UnderATick, kind) => {
            let value = match kind {
                FaultKind::Stop { for_ns, .. } => typed(Duration::from_nanos(for_ns)),
                _ => String::new(),
            };
            let tick_ms = period_s * 1e3;
            format!(
                "{what} = `{value}`: write a time of at least one tick, which is {tick_ms} ms here"
            )
        }
        (FaultRefusal::AfterTheEnd, _) => format!(
            "{what} never takes effect: the flight ends before; faults reach the stages {NOTICE_TICKS} ticks ahead"
        ),
        (FaultRefusal::NotReady, _) => format!(
            "{what}: the channel has no fresh command now, or all channels fly the same laws"
        ),
        (FaultRefusal::NothingToEnd, _) => format!("{what}=off: it is not active then or later"),
        (FaultRefusal::Contradiction, FaultKind::Messages { port, kind }) => format!(
            "`{}` is given twice for the same ticks at {port}: let one end before the other begins",
            kind.name()
        ),
        (FaultRefusal::Contradiction, kind) => match kind.role() {
            Some(role) => format!(
                "{what}: another fault of {role} acts in these ticks: let one end before the other begins"
            ),
            None => format!(
                "{what} is given for these ticks already: let one end before the other begins"
            ),
        },
    })
}

/// A time [s] in periods; a whole number if it is one but for rounding.
fn periods(time_s: f64, period_s: f64) -> f64 {
    let periods = time_s / period_s;
    if (periods - periods.round()).abs() < 1e-9 * periods {
        periods.round()
    } else {
        periods
    }
}
