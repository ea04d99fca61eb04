//! Faults as the user types them: `WHAT=VALUE[,WHAT=VALUE]@8s` or `@tick8000`, and `..9s` for an end.
//!
//! WHAT is a parameter of the airframe ([`parameter`]), messages at an input ([`message`]), a stage ([`stage`]), or the
//! loops' processor ([`processor`]).
//! What a fault is in the ticks of a flight is in [`plan`]. docs/injection.md is the user's page.

mod error;
pub mod listing;
pub mod live;
pub mod message;
pub mod parameter;
pub mod plan;
pub mod processor;
pub mod stage;
#[cfg(test)]
mod tests;
pub mod words;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

pub use error::FaultError;
use message::MessageChange;
use model::fault::Span;
use model::parameters::{Airframe, Parameter};
pub(crate) use parameter::check_once;
pub use parameter::{Wanted, WantedValue, targets_of};
use plant::Swap;
use processor::ProcessorChange;
use stage::StageChange;

/// When a fault strikes, or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum At {
    /// At a tick.
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
    /// From when on.
    pub from: At,
    /// Until when; none is for good, or once.
    pub to: Option<At>,
    /// What, each thing once.
    pub changes: Vec<Change>,
}

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// A parameter of the airframe has another value.
    Parameter(Wanted),
    /// Messages at an input.
    Messages(MessageChange),
    /// A stage is late, stopped or killed.
    Stage(StageChange),
    /// The loops' processor is kept busy.
    Processor(ProcessorChange),
    /// What lasts ends.
    Off(Lasting),
}

/// What lasts until it is ended. Its number means nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lasting {
    /// A fault of messages.
    Messages(MessageChange),
    /// A late stage.
    Stage(StageChange),
    /// A busy processor.
    Processor(ProcessorChange),
}

impl FromStr for Change {
    type Err = FaultError;

    /// Reads one `WHAT=VALUE`, or one `WHAT` that takes none.
    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (what, value) = match text.split_once('=') {
            Some((what, value)) => (what.trim(), Some(value.trim())),
            None => (text.trim(), None),
        };
        if !what.contains('.') {
            return text.parse().map(Self::Parameter);
        }
        if value == Some(OFF) {
            return Lasting::read(what).map(Self::Off);
        }
        Self::of_the_loop(what, value)
    }
}

/// The value that ends what lasts.
const OFF: &str = "off";

impl Change {
    /// What is wanted of a parameter, where it is one's.
    #[must_use]
    pub const fn wanted(&self) -> Option<Wanted> {
        match self {
            Self::Parameter(wanted) => Some(*wanted),
            _ => None,
        }
    }

    /// Whether it lasts as long as its ticks say.
    #[must_use]
    pub const fn lasts(&self) -> bool {
        match self {
            Self::Messages(_) | Self::Processor(_) => true,
            Self::Stage(stage) => stage.lasts(),
            Self::Parameter(_) | Self::Off(_) => false,
        }
    }

    /// What it is, without its value.
    #[must_use]
    pub fn what(&self) -> String {
        match self {
            Self::Parameter(wanted) => wanted.parameter.to_string(),
            Self::Messages(messages) => messages.what(),
            Self::Stage(stage) => stage.what(),
            Self::Processor(processor) => processor.what().to_owned(),
            Self::Off(lasting) => lasting.what(),
        }
    }

    fn of_the_loop(what: &str, value: Option<&str>) -> Result<Self, FaultError> {
        if let Some(change) = StageChange::read(what, value)? {
            return Ok(Self::Stage(change));
        }
        if let Some(change) = ProcessorChange::read(what, value)? {
            return Ok(Self::Processor(change));
        }
        match MessageChange::read(what, value)? {
            Some(change) => Ok(Self::Messages(change)),
            None => Err(words::unknown(what)),
        }
    }
}

impl Lasting {
    /// What is to end, by its name.
    fn read(what: &str) -> Result<Self, FaultError> {
        // Some value that the name takes: which one, nobody will look at.
        let some = match what.rsplit('.').next().unwrap_or_default() {
            "freeze" | "nan" | "kill" => None,
            "late" | "stop" => Some("1ms"),
            _ => Some("1"),
        };
        match Change::of_the_loop(what, some)? {
            Change::Messages(messages) => Ok(Self::Messages(messages)),
            Change::Processor(processor) => Ok(Self::Processor(processor)),
            Change::Stage(stage) if stage.lasts() => Ok(Self::Stage(stage)),
            Change::Stage(_) | Change::Parameter(_) | Change::Off(_) => Err(FaultError::NotLasting(what.to_owned())),
        }
    }

    /// Its name.
    #[must_use]
    pub fn what(&self) -> String {
        match self {
            Self::Messages(messages) => messages.what(),
            Self::Stage(stage) => stage.what(),
            Self::Processor(processor) => processor.what().to_owned(),
        }
    }
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (changes, at) = text.rsplit_once('@').ok_or_else(|| FaultError::NoInstant(text.to_owned()))?;
        if changes.contains('@') {
            return Err(FaultError::SeveralInstants(text.to_owned()));
        }
        let instant = |at: &str| match at.strip_prefix("tick") {
            Some(tick) => tick.parse().map(At::Tick).map_err(|_| FaultError::Instant(at.to_owned())),
            None => humantime::parse_duration(at).map(At::Time).map_err(|_| FaultError::Instant(at.to_owned())),
        };
        let (from, to) = match at.split_once("..") {
            Some((from, to)) => (instant(from)?, Some(instant(to)?)),
            None => (instant(at)?, None),
        };
        let changes = changes.split(',').map(str::parse).collect::<Result<Vec<Change>, _>>()?;
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
        let what = self.changes.iter().map(Change::to_string).collect::<Vec<_>>().join(",");
        self.to.map_or_else(|| what.clone(), |to| format!("{what} until {to}"))
    }

    /// What goes wrong with messages, stages and their processor.
    pub fn of_the_loop(&self) -> impl Iterator<Item = &Change> {
        self.changes.iter().filter(|change| !matches!(change, Change::Parameter(_)))
    }

    /// What is wanted of the airframe's parameters.
    #[must_use]
    pub fn wanted(&self) -> Vec<Wanted> {
        self.changes.iter().filter_map(Change::wanted).collect()
    }

    /// What of it the plant of an airframe schedules, with ticks of `period_s` [s]; nothing where it is no parameter's.
    ///
    /// # Errors
    /// Those of [`Wanted::of`].
    pub fn swap(&self, period_s: f64, airframe: &Airframe) -> Result<Option<Swap>, FaultError> {
        let wanted = self.wanted();
        if wanted.is_empty() {
            return Ok(None);
        }
        Ok(Some(Swap::to(self.from.tick(period_s), &targets_of(&wanted, airframe, period_s)?)?))
    }

    /// Its ticks, where one takes `period_s` [s].
    ///
    /// # Errors
    /// [`FaultError::Order`] where it ends before it begins.
    pub fn span(&self, period_s: f64) -> Result<Span, FaultError> {
        let (from, to) = (self.from.tick(period_s), self.to.map(|to| to.tick(period_s)));
        match to {
            Some(to) if to <= from => Err(FaultError::Order { fault: self.to_string(), from, to }),
            _ => Ok(Span { from, to: to.unwrap_or(Span::FOR_GOOD) }),
        }
    }

    /// Refuses an end for what has none.
    fn check_ends(&self) -> Result<(), FaultError> {
        if self.to.is_none() {
            return Ok(());
        }
        let endless = |change: &Change| match change {
            Change::Parameter(wanted) => Some(FaultError::ParameterEnds(wanted.parameter)),
            Change::Stage(stage) if !stage.lasts() => Some(FaultError::StageEnds(stage.what())),
            Change::Off(lasting) => Some(FaultError::StageEnds(format!("{}={OFF}", lasting.what()))),
            Change::Stage(_) | Change::Messages(_) | Change::Processor(_) => None,
        };
        self.changes.iter().find_map(endless).map_or(Ok(()), Err)
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(wanted) => wanted.fmt(f),
            Self::Messages(change) => change.fmt(f),
            Self::Stage(change) => change.fmt(f),
            Self::Processor(change) => change.fmt(f),
            Self::Off(lasting) => write!(f, "{}={OFF}", lasting.what()),
        }
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

/// A time as it is typed.
fn typed(time: Duration) -> String {
    humantime::format_duration(time).to_string().replace(' ', "")
}

/// A text, or the begin of a long one.
fn begin_of(text: &str) -> String {
    const MOST: usize = 40;
    let begin: String = text.chars().take(MOST).collect();
    if begin.len() < text.len() { begin + "..." } else { begin }
}

/// A unit as it ends a hint.
fn in_unit(parameter: Parameter) -> String {
    match parameter.spec().unit {
        "" => String::new(),
        unit => format!(" in {unit}"),
    }
}
