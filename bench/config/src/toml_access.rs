//! Reads TOML tables and values of settings, and describes them in errors.

use std::io::{self, Read as _};
use std::path::Path;
use std::sync::LazyLock;

use errors::{Failure, open_file};
use messages::parameters::{self, did_you_mean};
use toml::{Table, Value};

use crate::declarations::DEFAULT;
use crate::law_settings::LAW;
use crate::trajectory::is_file;

pub(super) static DEFAULT_TABLE: LazyLock<Table> =
    LazyLock::new(|| DEFAULT.parse().unwrap_or_default());

pub(super) fn table<'a>(of: &'a Table, section: &str) -> Option<&'a Table> {
    of.get(section).and_then(Value::as_table)
}

pub(super) fn text<'a>(of: &'a Table, section: &str, key: &str) -> Option<&'a str> {
    table(of, section)?.get(key).and_then(Value::as_str)
}

/// The content of a regular file of at most so many bytes: a device may have no end, and a pipe may have no writer.
pub fn bytes_of(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_file(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let what = format!("it is longer than {} MiB", most >> 20);
        return Err(io::Error::other(what));
    }
    Ok(bytes)
}

/// The text of a file of at most 1 MiB.
pub(super) fn text_of(path: &Path) -> io::Result<String> {
    io::read_to_string(&*bytes_of(path, 1 << 20)?)
}

/// The value as the type that is expected: whole numbers also stand for fractional ones.
pub(super) fn coerce(value: &Value, expected: &Value) -> Option<Value> {
    match (value, expected) {
        (Value::Integer(i), Value::Float(_)) => Some(Value::Float(*i as f64)),
        // "auto", or a number: of a processor, of microseconds.
        (Value::Integer(_), Value::String(auto)) if auto == "auto" => Some(value.clone()),
        (Value::Array(values), Value::Array(expected)) => match expected.first() {
            Some(first) if values.len() == expected.len() => values
                .iter()
                .map(|value| coerce(value, first))
                .collect::<Option<Vec<_>>>()
                .map(Value::Array),
            Some(_) => None,
            None => values.iter().all(Value::is_str).then(|| value.clone()),
        },
        _ => value.same_type(expected).then(|| value.clone()),
    }
}

pub(super) fn kind(expected: &Value) -> String {
    match expected {
        Value::Array(values) if values.is_empty() => "a list of strings".into(),
        Value::Array(values) => format!("a list of {} numbers", values.len()),
        Value::Float(_) => "a number".into(),
        Value::Integer(_) => "a whole number".into(),
        Value::String(auto) if auto == "auto" => "a whole number or a string".into(),
        Value::String(_) => "a string".into(),
        other => other.type_str().into(),
    }
}

/// How such a value is written: as the default has it, unless that is empty.
pub(super) fn example(expected: &Value) -> String {
    match expected {
        Value::Array(values) if values.is_empty() => "[\"rotational_drag_nm_s=0.315@8s\"]".into(),
        other => other.to_string(),
    }
}

pub(super) fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a String>) -> String {
    did_you_mean(parameters::nearest(name, known.map(String::as_str)))
}

/// The end of an error about a name that is not known: the one that may have been meant, or else all.
pub fn meant_or_known(name: &str, known: &[&str]) -> String {
    match parameters::nearest(name, known.iter().copied()) {
        None => format!("; there are {}", known.join(", ")),
        meant => did_you_mean(meant),
    }
}

/// Makes relative paths start at a folder: that of the file that has them, or the working directory.
pub(super) fn place_paths(keys: &mut Table, folder: &Path) -> Result<(), Failure> {
    let mut keys = keys.iter_mut();
    keys.try_for_each(|(key, value)| place_path(key, value, folder))
}

pub(super) fn place_path(key: &str, value: &mut Value, folder: &Path) -> Result<(), Failure> {
    match value {
        Value::Table(keys) => place_paths(keys, folder)?,
        Value::String(name) if key == LAW && plugin::is_file(name) => {
            *name = utf8(&folder.join(&*name))?;
        }
        Value::String(name) if ["trajectory", "airframe"].contains(&key) && is_file(name) => {
            // Roles in different folders mean the same file.
            let path = folder.join(&*name);
            *name = utf8(&path.canonicalize().unwrap_or(path))?;
        }
        _ => {}
    }
    Ok(())
}

/// A path as the text that settings, reports and logs have of it.
pub fn utf8(path: &Path) -> Result<String, Failure> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        let what = format!(
            "{}: this path is not UTF-8, as settings and logs are",
            path.display()
        );
        Failure::usage(what).help("rename its folder, or move the file into another one")
    })
}
