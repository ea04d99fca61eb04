//! Faults as the user types them: `WHAT=VALUE[,WHAT=VALUE]@8s` or `@tick8000`, and `..9s` for an end.
//!
//! WHAT is a parameter of the airframe (`parameter`), or a fault of messages, of a stage or of the processor by the
//! table in [`messages::fault::code`] (`change`). `plan` turns faults into ticks of a flight. docs/injection.md is the
//! user's page.

mod change;
mod error;
pub mod listing;
mod parameter;
pub mod plan;
#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

pub use change::{Change, LoopChange};
pub use error::FaultError;
pub(crate) use error::typed;
use messages::fault::Span;
use messages::fault::live::LiveFault;
use messages::parameters::Airframe;
pub(crate) use parameter::check_once;
pub use parameter::{Desired, RequestedValue, targets_of};
use plant::Swap;
use report::faults::InjectedFault;

/// When a fault strikes, or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum At {
    Tick(u64),
    /// At the tick that begins at this time of the flight.
    Time(Duration),
}

impl At {
    /// The tick, where one takes `period_s` [s].
    #[must_use]
    pub fn tick(self, period_s: f64) -> u64 {
        match self {
            Self::Tick(tick) => tick,
            Self::Time(time) => (time.as_secs_f64() / period_s).round() as u64,
        }
    }
}

/// What goes wrong together, and when.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    pub from: At,
    /// Until when; none is for good, or once.
    pub to: Option<At>,
    pub changes: Vec<Change>,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (changes, at) = text
            .rsplit_once('@')
            .ok_or_else(|| FaultError::NoInstant(text.to_owned()))?;
        if changes.contains('@') {
            return Err(FaultError::SeveralInstants(text.to_owned()));
        }
        let instant = |at: &str| match at.strip_prefix("tick") {
            Some(tick) => tick
                .parse()
                .map(At::Tick)
                .map_err(|_| FaultError::Instant(at.to_owned())),
            None => humantime::parse_duration(at)
                .map(At::Time)
                .map_err(|_| FaultError::Instant(at.to_owned())),
        };
        let (from, to) = match at.split_once("..") {
            Some((from, to)) => (instant(from)?, Some(instant(to)?)),
            None => (instant(at)?, None),
        };
        let changes = changes
            .split(',')
            .map(str::parse)
            .collect::<Result<Vec<Change>, _>>()?;
        let fault = Self { from, to, changes };
        fault.check_ends()?;
        check_once(&fault.wanted())?;
        Ok(fault)
    }
}

impl Fault {
    /// What goes wrong, as it is typed, and until when where it has an end.
    #[must_use]
    pub fn what(&self) -> String {
        let what = self
            .changes
            .iter()
            .map(Change::to_string)
            .collect::<Vec<_>>()
            .join(",");
        self.to
            .map_or_else(|| what.clone(), |to| format!("{what} until {to}"))
    }

    /// What goes wrong with messages, stages and their processor.
    pub fn of_the_loop(&self) -> impl Iterator<Item = &Change> {
        self.changes
            .iter()
            .filter(|change| !matches!(change, Change::Parameter(_)))
    }

    /// What is wanted of the airframe's parameters.
    #[must_use]
    pub fn wanted(&self) -> Vec<Desired> {
        self.changes.iter().filter_map(Change::wanted).collect()
    }

    /// What of it the plant of an airframe schedules, with ticks of `period_s` [s]; nothing where it is no parameter's.
    pub fn swap(&self, period_s: f64, airframe: &Airframe) -> Result<Option<Swap>, FaultError> {
        let wanted = self.wanted();
        if wanted.is_empty() {
            return Ok(None);
        }
        Ok(Some(Swap::to(
            self.from.tick(period_s),
            &targets_of(&wanted, airframe, period_s)?,
        )?))
    }

    /// Its ticks, where one takes `period_s` [s].
    pub fn span(&self, period_s: f64) -> Result<Span, FaultError> {
        let (from, to) = (
            self.from.tick(period_s),
            self.to.map(|to| to.tick(period_s)),
        );
        match to {
            Some(to) if to <= from => Err(FaultError::Order {
                fault: self.to_string(),
                from,
                to,
            }),
            _ => Ok(Span {
                from,
                to: to.unwrap_or(Span::FOR_GOOD),
            }),
        }
    }

    /// Refuses an end for what has none.
    fn check_ends(&self) -> Result<(), FaultError> {
        if self.to.is_none() {
            return Ok(());
        }
        let endless = |change: &Change| match change {
            Change::Parameter(wanted) => Some(FaultError::ParameterEnds(wanted.parameter)),
            Change::Loop(change) if change.ends => Some(FaultError::StageEnds(change.to_string())),
            Change::Loop(_) if !change.lasts() => Some(FaultError::StageEnds(change.what())),
            Change::Loop(_) => None,
        };
        self.changes.iter().find_map(endless).map_or(Ok(()), Err)
    }
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
        for (i, change) in self.changes.iter().enumerate() {
            write!(f, "{}{change}", if i == 0 { "" } else { "," })?;
        }
        write!(f, "@{}", self.from)?;
        self.to.map_or(Ok(()), |to| write!(f, "..{to}"))
    }
}

/// Injected faults as faults with the same ticks that can be planned.
#[must_use]
pub fn planned_again(live: &[LiveFault]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut rest = live;
    while let Some(first) = rest.first() {
        let (change, length) = Change::joined(rest, first);
        let to = Some(At::Tick(first.span.to))
            .filter(|_| change.lasts() && first.span.to != Span::FOR_GOOD);
        faults.push(Fault {
            from: At::Tick(first.span.from),
            to,
            changes: vec![change],
        });
        rest = &rest[length..];
    }
    faults
}

#[must_use]
pub fn injected(live: &[LiveFault], period_s: f64) -> Vec<InjectedFault> {
    let described = |fault: Fault| {
        let to = fault.to.map(|to| to.tick(period_s));
        let what = fault
            .changes
            .iter()
            .map(Change::to_string)
            .collect::<Vec<_>>()
            .join(",");
        InjectedFault::new(what, fault.from.tick(period_s), to, period_s).in_flight()
    };
    let mut ended = live.to_vec();
    for (place, end) in live.iter().enumerate().filter(|(_, fault)| fault.ends) {
        let is_meant = |fault: &&mut LiveFault| !fault.ends && fault.trouble.is_like(&end.trouble);
        ended[..place]
            .iter_mut()
            .filter(is_meant)
            .for_each(|fault| fault.span.to = fault.span.to.min(end.span.from));
    }
    planned_again(&ended).into_iter().map(described).collect()
}
