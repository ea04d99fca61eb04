//! Faults of stages: `outer.stop=20ms`, `inner.late=1500us`, `mixer.late=1ms..3ms`, `inner.kill`.

use std::fmt;
use std::time::Duration;

use model::fault::live::{LONGEST_NS, Trouble};
use model::role::{Role, STAGES};

use crate::fault::{FaultError, begin_of, typed};

/// The longest time that a stage stops or is late.
const LONGEST: Duration = Duration::from_nanos(LONGEST_NS);

/// What goes wrong with a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageChange {
    /// Which one.
    pub role: Role,
    /// What.
    pub kind: StageKind,
}

/// How a stage fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageKind {
    /// It computes for so much longer: a time between the two, each as likely.
    Late {
        /// The least.
        least: Duration,
        /// The most; the same where the time is always one.
        most: Duration,
    },
    /// It does nothing for so long, and then goes on.
    Stop(Duration),
    /// It ends, and is started anew.
    Kill,
}

impl StageChange {
    /// Reads a fault of a stage; nothing where it names none.
    ///
    /// # Errors
    /// [`FaultError`] where the value is not allowed.
    pub(super) fn read(what: &str, value: Option<&str>) -> Result<Option<Self>, FaultError> {
        let Some((name, word)) = what.split_once('.') else { return Ok(None) };
        let Some(role) = STAGES.into_iter().find(|role| role.name() == name) else { return Ok(None) };
        let kind = match word {
            "late" => late(what, value)?,
            "stop" => StageKind::Stop(time(what, value.unwrap_or_default())?),
            "kill" if value.is_some() => return Err(FaultError::TakesNoValue(what.to_owned())),
            // A flight ends with its plant.
            "kill" if !(Trouble::Kill { role }).is_possible() => return Err(FaultError::PlantKilled),
            "kill" => StageKind::Kill,
            _ => return Ok(None),
        };
        Ok(Some(Self { role, kind }))
    }

    /// Whether it lasts as long as its ticks say.
    pub(crate) const fn lasts(&self) -> bool {
        matches!(self.kind, StageKind::Late { .. })
    }

    /// What it is, without its value.
    #[must_use]
    pub fn what(&self) -> String {
        let word = match self.kind {
            StageKind::Late { .. } => "late",
            StageKind::Stop(_) => "stop",
            StageKind::Kill => "kill",
        };
        format!("{}.{word}", self.role)
    }
}

fn late(what: &str, value: Option<&str>) -> Result<StageKind, FaultError> {
    let value = value.unwrap_or_default();
    let (least, most) = match value.split_once("..") {
        Some((least, most)) => (time(what, least)?, time(what, most)?),
        None => (time(what, value)?, time(what, value)?),
    };
    if least > most {
        return Err(refused(what, value));
    }
    Ok(StageKind::Late { least, most })
}

fn time(what: &str, text: &str) -> Result<Duration, FaultError> {
    let time = humantime::parse_duration(text.trim()).ok();
    time.filter(|time| !time.is_zero() && *time <= LONGEST).ok_or_else(|| refused(what, text))
}

fn refused(what: &str, value: &str) -> FaultError {
    let several = if what.ends_with("late") {
        format!(", or from the least to the most, {what}=40us..400us")
    } else {
        String::new()
    };
    let allowed = format!("a time above 0 and up to {}, as in {what}=20ms{several}", typed(LONGEST));
    FaultError::Value { what: what.to_owned(), value: begin_of(value), allowed }
}

impl fmt::Display for StageChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what())?;
        match self.kind {
            StageKind::Late { least, most } if least == most => write!(f, "={}", typed(least)),
            StageKind::Late { least, most } => write!(f, "={}..{}", typed(least), typed(most)),
            StageKind::Stop(time) => write!(f, "={}", typed(time)),
            StageKind::Kill => Ok(()),
        }
    }
}
