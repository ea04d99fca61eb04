//! The status of a flight and its exit code.

use crate::phrase::name_of;
use errors::{FAILED, GATE, INTERRUPTED, OK};
use serde::{Deserialize, Serialize};
use std::fmt;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum FlightStatus {
    #[default]
    Flying,
    Pass,
    /// It held its gates as far as it was seen; not all was, or not all was logged.
    Incomplete,
    Fail,
    Interrupted,
    Aborted,
}

impl FlightStatus {
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Flying | Self::Pass | Self::Incomplete => OK,
            Self::Fail => GATE,
            Self::Interrupted => INTERRUPTED,
            Self::Aborted => FAILED,
        }
    }

    pub const fn is_over(self) -> bool {
        matches!(self, Self::Pass | Self::Incomplete | Self::Fail)
    }
}

impl fmt::Display for FlightStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&name_of(self))
    }
}
