//! What the faults of a flight are in its ticks: swaps, faults of messages, outages and lateness of stages, and what its
//! launcher does to processes.

use std::time::Duration;

use messages::fault::live::{Acts, FaultKind, LiveFault, LoopFaults, RESTART_NS, late_share};
use messages::fault::{NotTaken, Span};
use messages::parameters::Airframe;
use messages::role::Role;
use plant::Swap;

use crate::fault::error::typed;
use crate::fault::{Change, Fault, FaultError, planned_again};

/// How long a stage that was killed takes until it works again.
pub const RESTART: Duration = Duration::from_nanos(RESTART_NS);

/// The faults of a flight, in ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    pub swaps: Vec<Swap>,
    /// Those that stages strike themselves with: of messages, and lateness.
    pub loops: LoopFaults,
    /// What a launcher does to processes on the clock: stop, kill, keep the processor busy.
    pub acts: Vec<LiveFault>,
    /// The same, and lateness, by the rules that hold in flight, too.
    pub table: Acts,
    /// Those of stages, in simulated ticks.
    pub stages: Vec<StageFault>,
}

/// A fault of a stage, in ticks.
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
    /// None is worked, and the stage then begins anew.
    Anew,
    /// Each takes so many periods longer, between the two.
    Late {
        least: f64,
        most: f64,
    },
}

/// What becomes of a tick that a late stage works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lateness {
    /// Ticks by which what it publishes is late.
    pub output: u64,
    /// Ticks until it can work the next one; 1 is none missed.
    pub next: u64,
}

impl StageTicks {
    /// What becomes of a tick that was worked, by the seed of the flight.
    #[must_use]
    pub fn lateness(self, role: Role, seed: u64, tick: u64) -> Lateness {
        let Self::Late { least, most } = self else {
            return Lateness { output: 0, next: 1 };
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
    /// The faults of a flight of an airframe, with ticks of `period_s` [s] and a seed.
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
                if let Change::Loop(change) = change {
                    match change.kind {
                        FaultKind::Late { role, .. } if change.ends => {
                            planned.end_late(role, span.from);
                        }
                        _ if change.ends => {}
                        kind => planned.take_stage(&kind, span, period_s)?,
                    }
                }
                change
                    .faults(span)
                    .try_for_each(|fault| planned.take(&fault, period_s))?;
            }
        }
        Ok(planned)
    }

    fn take(&mut self, fault: &LiveFault, period_s: f64) -> Result<(), FaultError> {
        let taken = self.loops.take(fault).and_then(|()| self.table.take(fault));
        taken.map_err(|reason| refused(reason, fault, period_s))?;
        if !matches!(
            fault.trouble,
            FaultKind::Messages { .. } | FaultKind::Late { .. }
        ) {
            self.acts.push(*fault);
        }
        Ok(())
    }

    /// A stage is no longer late.
    fn end_late(&mut self, role: Role, tick: u64) {
        let is_late = |fault: &&mut StageFault| {
            fault.role == role && matches!(fault.kind, StageTicks::Late { .. })
        };
        self.stages
            .iter_mut()
            .filter(is_late)
            .for_each(|fault| fault.span = fault.span.cut(tick));
    }

    fn take_stage(
        &mut self,
        kind: &FaultKind,
        span: Span,
        period_s: f64,
    ) -> Result<(), FaultError> {
        let periods = |ns| periods(Duration::from_nanos(ns).as_secs_f64(), period_s);
        let out = |periods: f64| Span {
            from: span.from,
            to: span.from.saturating_add(periods.floor() as u64),
        };
        let (role, kind, span) = match *kind {
            FaultKind::Late {
                role,
                least_ns,
                most_ns,
            } => {
                let once = span.cut(span.from.saturating_add(1));
                let kind = StageTicks::Late {
                    least: periods(least_ns),
                    most: periods(most_ns),
                };
                let is_once = span.to == Span::FOR_GOOD;
                (role, kind, if is_once { once } else { span })
            }
            // One that is shorter than a tick is refused with the others of its table.
            FaultKind::Stop { role, for_ns } => (role, StageTicks::Out, out(periods(for_ns))),
            FaultKind::Kill { role } => (role, StageTicks::Anew, out(periods(RESTART_NS).max(1.0))),
            FaultKind::Messages { .. } | FaultKind::Hog { .. } | FaultKind::Load { .. } => {
                return Ok(());
            }
        };
        if let Some(other) = self
            .stages
            .iter()
            .find(|other| other.role == role && other.span.meets(span))
        {
            return Err(FaultError::StageMeets {
                role,
                first: other.span.from,
                second: span.from,
            });
        }
        self.stages.push(StageFault { role, kind, span });
        Ok(())
    }

    #[must_use]
    pub fn spares_the_loop(&self) -> bool {
        self.loops.messages.is_empty() && self.stages.is_empty()
    }
}

/// Why a fault is not taken, with its name, in a flight with ticks of `period_s` [s].
pub(crate) fn refused(reason: NotTaken, fault: &LiveFault, period_s: f64) -> FaultError {
    let what = || {
        let change = planned_again(&[*fault])
            .first()
            .and_then(|fault| fault.changes.first().copied());
        change.map(|change| change.what()).unwrap_or_default()
    };
    match (reason, fault.trouble) {
        (NotTaken::NoRoom, _) => FaultError::TooMany,
        (NotTaken::UnderATick, trouble) => FaultError::Value {
            what: what(),
            value: match trouble {
                FaultKind::Stop { for_ns, .. } => typed(Duration::from_nanos(for_ns)),
                _ => String::new(),
            },
            allowed: format!(
                "a time of at least one tick, which is {} ms here",
                period_s * 1e3
            ),
        },
        (NotTaken::AfterTheEnd, _) => FaultError::AfterTheEnd(what()),
        (NotTaken::NothingToEnd, _) => FaultError::NothingToEnd(what()),
        (NotTaken::Contradiction, FaultKind::Messages { port, kind }) => {
            FaultError::Contradiction {
                what: kind.name(),
                port,
            }
        }
        (NotTaken::Contradiction, _) => FaultError::Again(what()),
    }
}

/// A time [s] in periods; where it is whole ones but for rounding, it is whole.
fn periods(time_s: f64, period_s: f64) -> f64 {
    let periods = time_s / period_s;
    if (periods - periods.round()).abs() < 1e-9 * periods {
        periods.round()
    } else {
        periods
    }
}
