//! What the faults of a flight are in its ticks: swaps, faults of messages, outages and lateness of stages, and what its
//! launcher does to processes.

use std::time::Duration;

use model::fault::acts::{Acts, RESTART_NS};
use model::fault::live::{LiveFault, LoopFaults, Trouble};
use model::fault::{NotTaken, Span, late};
use model::parameters::Airframe;
use model::role::Role;
use plant::Swap;

use crate::fault::live::planned_again;
use crate::fault::stage::{StageChange, StageKind};
use crate::fault::{Change, Fault, FaultError, Lasting, typed};

/// How long a stage that was killed takes until it works again.
pub const RESTART: Duration = Duration::from_nanos(RESTART_NS);

/// The faults of a flight, in ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// Those of the airframe.
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
    /// Which stage.
    pub role: Role,
    /// What.
    pub kind: StageTicks,
    /// The ticks that it strikes.
    pub span: Span,
}

/// What a fault does to the ticks of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StageTicks {
    /// None is worked.
    Out,
    /// None is worked, and the stage then begins anew.
    Anew,
    /// Each takes so many periods longer, between the two.
    Late {
        /// The least.
        least: f64,
        /// The most.
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
        let Self::Late { least, most } = self else { return Lateness { output: 0, next: 1 } };
        let periods = least + (most - least) * late::share(role, seed, tick);
        // A whole number of periods is reached in the tick that then begins.
        Lateness { output: periods.floor() as u64, next: (periods.ceil() as u64).max(1) }
    }
}

impl Planned {
    /// The faults of a flight of an airframe, with ticks of `period_s` [s] and a seed.
    ///
    /// # Errors
    /// [`FaultError`] of the first that cannot be, alone or beside the others.
    pub fn new(faults: &[Fault], period_s: f64, airframe: &Airframe, seed: u64) -> Result<Self, FaultError> {
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
                match change {
                    Change::Stage(stage) => planned.take_stage(stage, span, period_s)?,
                    Change::Off(Lasting::Stage(stage)) => planned.end_late(stage.role, span.from),
                    Change::Parameter(_) | Change::Messages(_) | Change::Processor(_) | Change::Off(_) => {}
                }
                change.faults(span).try_for_each(|fault| planned.take(&fault, period_s))?;
            }
        }
        Ok(planned)
    }

    fn take(&mut self, fault: &LiveFault, period_s: f64) -> Result<(), FaultError> {
        let taken = self.loops.take(fault).and_then(|()| self.table.take(fault));
        taken.map_err(|reason| refused(reason, fault, period_s))?;
        if !matches!(fault.trouble, Trouble::Messages { .. } | Trouble::Late { .. }) {
            self.acts.push(*fault);
        }
        Ok(())
    }

    /// A stage is no longer late.
    fn end_late(&mut self, role: Role, tick: u64) {
        let is_late = |fault: &&mut StageFault| fault.role == role && matches!(fault.kind, StageTicks::Late { .. });
        self.stages.iter_mut().filter(is_late).for_each(|fault| fault.span = fault.span.cut(tick));
    }

    fn take_stage(&mut self, change: &StageChange, span: Span, period_s: f64) -> Result<(), FaultError> {
        let periods = |time: Duration| periods(time.as_secs_f64(), period_s);
        let out = |periods: f64| Span { from: span.from, to: span.from.saturating_add(periods.floor() as u64) };
        let (kind, span) = match change.kind {
            StageKind::Late { least, most } => {
                let once = Span { to: span.from.saturating_add(1), ..span };
                let kind = StageTicks::Late { least: periods(least), most: periods(most) };
                (kind, if span.to == Span::FOR_GOOD { once } else { span })
            }
            // One that is shorter than a tick is refused with the others of its table.
            StageKind::Stop(time) => (StageTicks::Out, out(periods(time))),
            StageKind::Kill => (StageTicks::Anew, out(periods(RESTART).max(1.0))),
        };
        let role = change.role;
        if let Some(other) = self.stages.iter().find(|other| other.role == role && other.span.meets(span)) {
            return Err(FaultError::StageMeets { role, first: other.span.from, second: span.from });
        }
        self.stages.push(StageFault { role, kind, span });
        Ok(())
    }

    /// Whether nothing strikes but swaps.
    #[must_use]
    pub fn spares_the_loop(&self) -> bool {
        self.loops.messages.is_empty() && self.stages.is_empty()
    }
}

/// Why a fault is not taken, in its words, in a flight with ticks of `period_s` [s].
pub(crate) fn refused(reason: NotTaken, fault: &LiveFault, period_s: f64) -> FaultError {
    let what = || {
        let change = planned_again(&[*fault]).first().and_then(|fault| fault.changes.first().copied());
        change.map(|change| change.what()).unwrap_or_default()
    };
    match (reason, fault.trouble) {
        (NotTaken::NoRoom, _) => FaultError::TooMany,
        (NotTaken::UnderATick, trouble) => FaultError::Value {
            what: what(),
            value: match trouble {
                Trouble::Stop { for_ns, .. } => typed(Duration::from_nanos(for_ns)),
                _ => String::new(),
            },
            allowed: format!("a time of at least one tick, which is {} ms here", period_s * 1e3),
        },
        (NotTaken::AfterTheEnd, _) => FaultError::AfterTheEnd(what()),
        (NotTaken::NothingToEnd, _) => FaultError::NothingToEnd(what()),
        (NotTaken::Contradiction, Trouble::Messages { port, kind }) => {
            FaultError::Contradiction { what: kind.name(), port }
        }
        (NotTaken::Contradiction, _) => FaultError::Again(what()),
    }
}

/// A time [s] in periods; where it is whole ones but for rounding, it is whole.
fn periods(time_s: f64, period_s: f64) -> f64 {
    let periods = time_s / period_s;
    if (periods - periods.round()).abs() < 1e-9 * periods { periods.round() } else { periods }
}
