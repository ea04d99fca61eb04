//! Failures of the rig as exceptions of Python.

use errors::Failure;
use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(
    ironbird,
    SettingsError,
    PyValueError,
    "A setting is unknown, or not what it may be."
);
create_exception!(
    ironbird,
    LogError,
    PyValueError,
    "There is no such flight, or its log cannot be read."
);

/// What a command prints of a failure, without its first word.
fn message(failure: &Failure) -> String {
    let text = failure.text();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    text.trim_end().to_owned()
}

pub(crate) fn settings_error(failure: Failure) -> PyErr {
    SettingsError::new_err(message(&failure))
}

pub(crate) fn log_error(failure: Failure) -> PyErr {
    LogError::new_err(message(&failure))
}
