//! Faults of the loops' processor: `cpu.hog=90`, `cpu.load=0.5`.

use std::fmt;
use std::str::FromStr;

use model::fault::live::{HIGHEST_PRIORITY, Trouble};

use crate::fault::{FaultError, begin_of};

/// What a process beside the loops does to their processor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProcessorChange {
    /// It is always busy, under SCHED_FIFO at this priority.
    Hog(u8),
    /// It is busy in this share of its time, at ordinary priority.
    Load(f64),
}

impl ProcessorChange {
    /// Reads a fault of the processor; nothing where it names none.
    ///
    /// # Errors
    /// [`FaultError::Value`] where the value is not allowed.
    pub(super) fn read(what: &str, value: Option<&str>) -> Result<Option<Self>, FaultError> {
        let text = value.unwrap_or_default();
        let refused = |allowed: String| FaultError::Value { what: what.to_owned(), value: begin_of(text), allowed };
        Ok(Some(match what {
            "cpu.hog" => read(text, Self::Hog).ok_or_else(|| {
                refused(format!("a SCHED_FIFO priority from 1 to {HIGHEST_PRIORITY}, as in cpu.hog=90"))
            })?,
            "cpu.load" => read(text, Self::Load)
                .ok_or_else(|| refused("a share above 0 and up to 1, as in cpu.load=0.5".into()))?,
            _ => return Ok(None),
        }))
    }

    /// The same as processes have it.
    #[must_use]
    pub fn trouble(self) -> Trouble {
        match self {
            Self::Hog(priority) => Trouble::Hog { priority: u64::from(priority) },
            Self::Load(share) => Trouble::Load { share },
        }
    }

    /// What it is, without its value.
    #[must_use]
    pub const fn what(self) -> &'static str {
        match self {
            Self::Hog(_) => "cpu.hog",
            Self::Load(_) => "cpu.load",
        }
    }
}

/// A number that the fault may have.
fn read<N: FromStr>(text: &str, of: fn(N) -> ProcessorChange) -> Option<ProcessorChange> {
    text.parse().ok().map(of).filter(|change| change.trouble().is_possible())
}

impl fmt::Display for ProcessorChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hog(priority) => write!(f, "{}={priority}", self.what()),
            Self::Load(share) => write!(f, "{}={share:?}", self.what()),
        }
    }
}
