//! Faults as the user types them: `WHAT=VALUE[,WHAT=VALUE]@8s` or `@tick8000`, and `..9s` for an end.
//!
//! WHAT is a parameter of the airframe (`parameter`), or a fault of messages, of a stage or of the processor by the
//! table [`crate::FAULTS`] (`change`). [`crate::plan`] turns faults into ticks of a flight. docs/injection.md is the
//! user's page.

mod change;
mod error;
mod parameter;
#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use crate::Span;
use crate::live::LiveFault;
use crate::swap::Swap;
pub use change::{Change, LoopChange};
pub use error::FaultError;
pub use error::{begin_of, duration, typed};
use messages::parameters::Airframe;
pub use parameter::check_once;
pub use parameter::{Desired, RequestedValue, targets_of};

/// When a fault begins or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum At {
    Tick(u64),
    /// The tick that begins at this time of the flight.
    Time(Duration),
}

impl At {
    pub fn tick(self, period_s: f64) -> u64 {
        match self {
            Self::Tick(tick) => tick,
            Self::Time(time) => (time.as_secs_f64() / period_s).round() as u64,
        }
    }
}

impl FromStr for At {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let at = match text.strip_prefix("tick") {
            Some(tick) => tick.parse().ok().map(Self::Tick),
            None => humantime::parse_duration(text).ok().map(Self::Time),
        };
        at.ok_or_else(|| {
            FaultError::fault(format!(
                "`{text}` is no instant: write @8s, @500ms or @tick8000, and ..9s behind it for an end"
            ))
        })
    }
}

/// Changes that begin, and end, together.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    pub from: At,
    /// `None` lasts until the flight ends, or happens once.
    pub to: Option<At>,
    pub changes: Vec<Change>,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (changes, at) = text.rsplit_once('@').ok_or_else(|| {
            FaultError::fault(format!(
                "`{text}` has no time: write it behind, as in {text}@8s or {text}@tick8000"
            ))
        })?;
        if changes.contains('@') {
            return Err(FaultError::fault(format!(
                "`{text}` has several instants: give --fault once for each"
            )));
        }
        let (from, to) = match at.split_once("..") {
            Some((from, to)) => (from.parse()?, Some(to.parse()?)),
            None => (at.parse()?, None),
        };
        let fault = Self {
            from,
            to,
            changes: changes
                .split(',')
                .map(str::parse)
                .collect::<Result<_, _>>()?,
        };
        if to.is_some() {
            fault.changes.iter().try_for_each(Change::check_end)?;
        }
        check_once(&fault.wanted())?;
        Ok(fault)
    }
}

impl Fault {
    /// The changes as they are typed, and until when where there is an end.
    pub fn what(&self) -> String {
        let what = joined(&self.changes);
        self.to
            .map_or_else(|| what.clone(), |to| format!("{what} until {to}"))
    }

    /// The changes of messages, stages and the processor.
    pub fn of_the_loop(&self) -> impl Iterator<Item = &Change> {
        self.changes
            .iter()
            .filter(|change| !matches!(change, Change::Parameter(_)))
    }

    /// The changes of parameters.
    pub fn wanted(&self) -> Vec<Desired> {
        self.changes.iter().filter_map(Change::wanted).collect()
    }

    /// The parameter changes as the plant schedules them; `None` if there are none.
    pub fn swap(&self, period_s: f64, airframe: &Airframe) -> Result<Option<Swap>, FaultError> {
        let wanted = self.wanted();
        if wanted.is_empty() {
            return Ok(None);
        }
        let targets = targets_of(&wanted, airframe, period_s)?;
        Ok(Some(Swap::to(self.from.tick(period_s), &targets)?))
    }

    pub fn span(&self, period_s: f64) -> Result<Span, FaultError> {
        let from = self.from.tick(period_s);
        let to = self.to.map_or(Span::FOR_GOOD, |to| to.tick(period_s));
        if self.to.is_some() && to <= from {
            return Err(FaultError::fault(format!(
                "`{self}` ends at tick {to}, and begins at tick {from}: write an end from tick {} on, as in @8s..9s, or \
                 leave it out",
                from.saturating_add(1)
            )));
        }
        Ok(Span { from, to })
    }
}

/// Changes as the user types them.
pub fn joined<'a>(changes: impl IntoIterator<Item = &'a Change>) -> String {
    let texts: Vec<String> = changes.into_iter().map(Change::to_string).collect();
    texts.join(",")
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tick(tick) => write!(f, "tick{tick}"),
            Self::Time(time) => f.write_str(&typed(*time)),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", joined(&self.changes), self.from)?;
        self.to.map_or(Ok(()), |to| write!(f, "..{to}"))
    }
}

/// Injected faults as faults with the same ticks that can be planned.
pub fn planned_again(live: &[LiveFault]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut rest = live;
    while let Some(first) = rest.first() {
        let (change, length) = Change::joined(rest, first);
        let ends = change.lasts() && first.span.to != Span::FOR_GOOD;
        faults.push(Fault {
            from: At::Tick(first.span.from),
            to: ends.then_some(At::Tick(first.span.to)),
            changes: vec![change],
        });
        rest = &rest[length..];
    }
    faults
}
