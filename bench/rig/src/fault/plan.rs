//! What the faults of a flight are in its ticks: swaps, faults of messages, outages and lateness of stages.

use std::time::Duration;

use model::fault::{MessageFault, MessageFaults, Span};
use model::noise::uniform;
use model::parameters::Airframe;
use model::role::Role;
use plant::Swap;

use crate::fault::stage::{StageChange, StageKind};
use crate::fault::{Change, Fault, FaultError, typed};

/// How long a stage that was killed takes until it works again: a launcher that lets nothing start anew within 50 ms, and
/// a process that is ready well within as much again.
pub const RESTART: Duration = Duration::from_millis(100);

/// Streams of random numbers of late stages; those of messages lie below.
const FIRST_STREAM: u64 = 1 << 33;

/// The faults of a flight, in ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// Those of the airframe.
    pub swaps: Vec<Swap>,
    /// Those of messages.
    pub messages: MessageFaults,
    /// Those of stages.
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
        let periods = least + (most - least) * uniform(seed, tick, FIRST_STREAM + role as u64);
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
        let mut planned = Self { swaps: Vec::new(), messages: MessageFaults::none(seed), stages: Vec::new() };
        for fault in faults {
            let span = fault.span(period_s)?;
            planned.swaps.extend(fault.swap(period_s, airframe)?);
            for change in &fault.changes {
                match change {
                    Change::Parameter(_) => {}
                    Change::Messages(messages) => {
                        for port in messages.inputs.ports() {
                            planned.take(MessageFault { port, kind: messages.kind, span })?;
                        }
                    }
                    Change::Stage(stage) => planned.take_stage(stage, span, period_s)?,
                }
            }
        }
        Ok(planned)
    }

    fn take(&mut self, fault: MessageFault) -> Result<(), FaultError> {
        if self.messages.iter().any(|(_, other)| other.contradicts(&fault)) {
            return Err(FaultError::Contradiction { what: fault.kind.name(), port: fault.port });
        }
        self.messages.push(fault).map_err(|_| FaultError::TooMany)
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
            StageKind::Stop(time) if periods(time) < 1.0 => {
                let allowed = format!("a time of at least one tick, which is {} ms here", period_s * 1e3);
                return Err(FaultError::Value { what: change.what(), value: typed(time), allowed });
            }
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
        self.messages.is_empty() && self.stages.is_empty()
    }
}

/// A time [s] in periods; where it is whole ones but for rounding, it is whole.
fn periods(time_s: f64, period_s: f64) -> f64 {
    let periods = time_s / period_s;
    if (periods - periods.round()).abs() < 1e-9 * periods { periods.round() } else { periods }
}
