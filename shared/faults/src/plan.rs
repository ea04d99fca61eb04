//! The faults of a flight in its ticks: swaps, faults of messages, outages and lateness of stages, and what the
//! supervisor does to processes.

use std::time::Duration;

use crate::live::{LoopFaults, MAX_LIVE_FAULTS, MAX_MESSAGE_FAULTS, NOTICE_TICKS, late_share};
use crate::swap::Swap;
use crate::{FaultRefusal, LiveFault, Span, StageTicks};
use messages::parameters::Airframe;
use messages::role::Role;

use crate::grammar::{Change, Fault, FaultError};

#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    pub swaps: Vec<Swap>,
    pub loops: LoopFaults,
    /// Faults of stages, their processor and channels, and their ends, in the order in which they are given.
    pub acts: Vec<LiveFault>,
    /// Those of stages, in simulated ticks.
    pub stages: Vec<StageFault>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageFault {
    pub role: Role,
    pub ticks: StageTicks,
    pub span: Span,
    period_s: f64,
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

impl StageFault {
    /// Whether the stage starts again after it.
    pub const fn starts_anew(&self) -> bool {
        matches!(self.ticks, StageTicks::Anew(_))
    }

    /// Lateness of a tick, by the seed of the flight; none where the stage misses it.
    pub fn lateness(&self, seed: u64, tick: u64) -> Option<Lateness> {
        let StageTicks::Late(range_ns) = self.ticks else {
            return None;
        };
        let [least, most] = range_ns.map(|ns| periods(ns, self.period_s));
        let periods = least + (most - least) * late_share(self.role, seed, tick);
        // A whole number of periods is reached in the tick that then begins.
        Some(Lateness {
            output: periods.floor() as u64,
            next: (periods.ceil() as u64).max(1),
        })
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
            loops: LoopFaults::none(seed, (period_s * 1e9).round() as u64),
            acts: Vec::new(),
            stages: Vec::new(),
        };
        for fault in faults {
            let span = fault.span(period_s)?;
            planned.swaps.extend(fault.swap(period_s, airframe)?);
            for fault in fault.changes.iter().flat_map(|it| it.faults(span)) {
                let taken = planned.loops.take(&fault);
                taken.map_err(|reason| refused(reason, &fault, period_s))?;
                if fault.kind.port().is_none() {
                    planned.acts.push(fault);
                }
            }
        }
        let processes = planned.loops.processes.iter();
        planned.stages = processes
            .filter_map(|(_, it)| stage_fault(it, period_s))
            .collect();
        Ok(planned)
    }

    /// Whether neither messages nor stages have faults.
    pub fn has_no_loop_faults(&self) -> bool {
        self.loops.messages.is_empty() && self.stages.is_empty()
    }
}

/// What a fault does to its stage in simulated ticks; `None` if other channels fly meanwhile, or no stage has it.
fn stage_fault(fault: &LiveFault, period_s: f64) -> Option<StageFault> {
    let ticks = fault.kind.stage_ticks()?;
    let first = fault.span.from;
    let out = |ticks: f64| Span::new(first, first.saturating_add(ticks.floor() as u64));
    let span = match ticks {
        StageTicks::Late(_) => fault.span,
        StageTicks::Out(ns) => out(periods(ns, period_s)),
        StageTicks::Anew(ns) => out(periods(ns, period_s).max(1.0)),
    };
    let is_alone = fault.kind.channel().is_none();
    is_alone.then_some(StageFault {
        role: fault.kind.role()?,
        ticks,
        span,
        period_s,
    })
}

/// Why a fault is not taken, with its name, in a flight with ticks of `period_s` [s].
pub fn refused(reason: FaultRefusal, fault: &LiveFault, period_s: f64) -> FaultError {
    let change = Change::joined(&[*fault], fault).0;
    let what = change.what();
    FaultError::fault(match reason {
        FaultRefusal::NoRoom => format!(
            "there are more than {MAX_MESSAGE_FAULTS} faults of messages, counted by input, or more than \
             {MAX_LIVE_FAULTS} others: leave some out"
        ),
        FaultRefusal::UnderATick => format!(
            "{change}: write a time of at least one tick, which is {} ms here",
            period_s * 1e3
        ),
        FaultRefusal::AfterTheEnd => format!(
            "{what} never takes effect: the flight ends before; faults reach the stages {NOTICE_TICKS} ticks ahead"
        ),
        FaultRefusal::NotReady => format!(
            "{what}: the channel has no fresh command now, or all channels fly the same laws"
        ),
        FaultRefusal::NothingToEnd => format!("{what}=off: it is not active then or later"),
        FaultRefusal::Contradiction => {
            let (name, kind) = (fault.kind.spec().name, fault.kind);
            let given = match (kind.port(), kind.role()) {
                (Some(port), _) => format!("`{name}` is given twice for the same ticks at {port}"),
                (_, Some(role)) => format!("{what}: another fault of {role} acts in these ticks"),
                (None, None) => format!("{what} is given for these ticks already"),
            };
            format!("{given}: let one end before the other begins")
        }
    })
}

/// A time in periods; a whole number if only rounding makes the difference: of the time, or of the period to whole
/// nanoseconds.
pub(crate) fn periods(time_ns: u64, period_s: f64) -> f64 {
    let periods = Duration::from_nanos(time_ns).as_secs_f64() / period_s;
    let rounding = 1e-9 + 0.5e-9 / period_s;
    if (periods - periods.round()).abs() < rounding * periods {
        periods.round()
    } else {
        periods
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_periods_are_whole_whatever_the_period_is_rounded_to() {
        for rate_hz in [600.0, 900.0, 1000.0, 1500.0, 3000.0, 7000.0, 8000.0] {
            let period_s: f64 = 1.0 / rate_hz;
            let tick_ns = (period_s * 1e9).round() as u64;
            for ticks in [1, 100, 2000] {
                assert_eq!(periods(ticks * tick_ns, period_s), ticks as f64);
            }
        }
        assert_eq!(periods(1_500_000, 1e-3), 1.5);
    }
}
