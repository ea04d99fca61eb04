//! Faults of the loops' processor: `cpu.hog=90`, `cpu.load=0.5`.

use std::fmt;

use crate::fault::{FaultError, begin_of};

/// What a process beside the loops does to their processor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProcessorChange {
    /// It is always busy, under SCHED_FIFO at this priority.
    Hog(u8),
    /// It is busy in this share of its time, at ordinary priority.
    Load(f64),
}

/// The highest priority of SCHED_FIFO.
const HIGHEST: u8 = 99;

impl ProcessorChange {
    /// Reads a fault of the processor; nothing where it names none.
    ///
    /// # Errors
    /// [`FaultError::Value`] where the value is not allowed.
    pub(super) fn read(what: &str, value: Option<&str>) -> Result<Option<Self>, FaultError> {
        let text = value.unwrap_or_default();
        let refused = |allowed: String| FaultError::Value { what: what.to_owned(), value: begin_of(text), allowed };
        Ok(Some(match what {
            "cpu.hog" => {
                let priority = text.parse().ok().filter(|priority| (1..=HIGHEST).contains(priority));
                Self::Hog(
                    priority.ok_or_else(|| {
                        refused(format!("a SCHED_FIFO priority from 1 to {HIGHEST}, as in cpu.hog=90"))
                    })?,
                )
            }
            "cpu.load" => {
                let share = text.parse().ok().filter(|share| *share > 0.0 && *share <= 1.0);
                Self::Load(share.ok_or_else(|| refused("a share above 0 and up to 1, as in cpu.load=0.5".into()))?)
            }
            _ => return Ok(None),
        }))
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

impl fmt::Display for ProcessorChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hog(priority) => write!(f, "{}={priority}", self.what()),
            Self::Load(share) => write!(f, "{}={share:?}", self.what()),
        }
    }
}
