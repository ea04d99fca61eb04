//! Settings as nested dicts: the sections and keys of a settings file.

use config::Overrides;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyString};
use toml::{Table, Value};

use crate::errors::SettingsError;

/// The settings that have an argument of their own, which goes before them as a flag of the command line does.
const ARGUMENTS: [&str; 9] = [
    "flight.trajectory",
    "flight.duration_s",
    "flight.airframe",
    "flight.preset",
    "flight.faults",
    "flight.seed",
    "outer.law",
    "inner.law",
    "mixer.law",
];

/// What arguments say, by the keys of their settings.
pub(crate) fn overrides(arguments: &Bound<'_, PyDict>) -> PyResult<Overrides> {
    let said = ARGUMENTS
        .into_iter()
        .filter_map(|key| Some((key, arguments.get_item(key).transpose()?)));
    said.map(|(key, given)| Ok((key, value(&given?, key)?)))
        .collect()
}

pub(crate) fn table(dict: &Bound<'_, PyDict>, path: &str) -> PyResult<Table> {
    let mut table = Table::new();
    for (key, given) in dict {
        let Ok(key) = key.extract::<String>() else {
            return Err(SettingsError::new_err(format!(
                "settings: the key {} is no string",
                key.repr()?
            )));
        };
        let path = format!("{path}.{key}");
        let value = value(&given, path.trim_start_matches('.'))?;
        table.insert(key, value);
    }
    Ok(table)
}

fn value(given: &Bound<'_, PyAny>, path: &str) -> PyResult<Value> {
    const DEEPEST: usize = 32;
    if path.matches(['.', '[']).count() > DEEPEST {
        let begin: String = path.chars().take(60).collect();
        return Err(SettingsError::new_err(format!(
            "settings: {begin}...: dicts and lists in each other more than {DEEPEST} deep, or one that contains itself"
        )));
    }
    if let Ok(dict) = given.cast::<PyDict>() {
        return table(dict, path).map(Value::Table);
    }
    if let Ok(text) = given.cast::<PyString>() {
        return Ok(Value::String(text.extract()?));
    }
    if given.is_instance_of::<PyBool>() {
        return given.extract().map(Value::Boolean);
    }
    if let Ok(number) = given.extract::<i64>() {
        return Ok(Value::Integer(number));
    }
    if let Ok(number) = given.extract::<f64>() {
        return Ok(Value::Float(number));
    }
    match given.try_iter() {
        Ok(values) => values
            .map(|given| value(&given?, &format!("{path}[]")))
            .collect::<PyResult<_>>()
            .map(Value::Array),
        Err(_) => Err(SettingsError::new_err(format!(
            "settings: {path} = {}: expected a number, a string, a list or a dict",
            given.repr()?
        ))),
    }
}
