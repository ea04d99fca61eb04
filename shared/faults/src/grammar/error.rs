//! Why a fault was refused, and the texts that errors share.

use std::time::Duration;

use crate::swap::SwapError;
use messages::parameters::ParameterError;
use thiserror::Error;

#[derive(Clone, Debug, PartialEq, Error)]
#[error("{message}")]
pub struct FaultError {
    message: String,
    is_of_parameter: bool,
}

impl FaultError {
    pub fn fault(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            is_of_parameter: false,
        }
    }

    pub(super) fn parameter(message: impl Into<String>) -> Self {
        Self {
            is_of_parameter: true,
            ..Self::fault(message)
        }
    }

    /// Where what is allowed is listed; `flags` of `ironbird params` choose the airframe.
    pub fn listed(&self, flags: &str) -> String {
        if self.is_of_parameter {
            format!("`ironbird params{flags}` lists names, units and ranges")
        } else {
            "`ironbird faults` lists what there is".into()
        }
    }
}

impl From<ParameterError> for FaultError {
    fn from(error: ParameterError) -> Self {
        Self::parameter(error.to_string())
    }
}

impl From<SwapError> for FaultError {
    fn from(error: SwapError) -> Self {
        Self::parameter(error.to_string())
    }
}

/// A time as it is typed.
pub fn typed(time: Duration) -> String {
    humantime::format_duration(time)
        .to_string()
        .replace(' ', "")
}

/// A length of time with its unit.
pub fn duration(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|e| {
        let why = match text.strip_prefix('-') {
            Some(_) => "a time is not negative".into(),
            None => e.to_string(),
        };
        format!(
            "{}; write a number of 0 or more and its unit, as in 500ms, 30s or 2m",
            why.trim_end()
        )
    })
}

/// A text, or the beginning of a long one.
pub fn begin_of(text: &str) -> String {
    const MOST: usize = 40;
    let begin: String = text.chars().take(MOST).collect();
    if begin.len() < text.len() {
        begin + "..."
    } else {
        begin
    }
}
