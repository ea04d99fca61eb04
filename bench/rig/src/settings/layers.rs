//! Merges the layers of the settings (default, preset, file, flags) and checks the file.

use std::io::{self, Read as _};
use std::path::Path;

use controller::{Gains, Preset};
use toml::{Table, Value};

use crate::settings::{DEFAULT, Overrides};
use failure::{Failure, open_file};

/// The settings as a table, and the file that had a part in them.
pub(super) fn layered<'a>(file: Option<&'a Path>, overrides: &Overrides) -> Result<(Table, Option<&'a Path>), Failure> {
    let mut table: Table = DEFAULT.parse().map_err(|e| Failure::failed(format!("the default is broken: {e}")))?;
    let given = file.map(|path| read(path, &table)).transpose()?.unwrap_or_default();
    let flag = |key: &str| overrides.iter().find(|(k, _)| *k == key).map(|(_, value)| value);
    let preset = flag("flight.preset").or_else(|| given.get("flight")?.get("preset")).and_then(Value::as_str);
    if let Some(preset) = preset {
        let preset: Preset = preset.parse().map_err(|e| {
            // A flag with an unknown name does not come this far.
            let place = file.map(|path| format!(" (settings file {})", path.display())).unwrap_or_default();
            Failure::usage(format!("flight.preset: {e}{place}")).help("see `ironbird fly --print-config`")
        })?;
        let gains = Table::try_from(Gains::preset(preset)).map_err(|e| Failure::failed(e.to_string()))?;
        table.insert("gains".into(), Value::Table(gains));
    }
    for (section, keys) in given {
        if let (Some(Value::Table(into)), Value::Table(keys)) = (table.get_mut(&section), keys) {
            into.extend(keys);
        }
    }
    for (key, value) in overrides {
        if let Some((section, key)) = key.split_once('.')
            && let Some(Value::Table(into)) = table.get_mut(section)
        {
            into.insert(key.into(), value.clone());
        }
    }
    Ok((table, file))
}

/// Reads a settings file: every key must be known, and of the type that the default has.
fn read(path: &Path, default: &Table) -> Result<Table, Failure> {
    let text = text_of(path).map_err(|e| {
        Failure::usage(format!("cannot read the settings file {}: {e}", path.display()))
            .help("name a file that you can read; `ironbird fly --print-config` writes one to begin with")
    })?;
    let here = |what: String| {
        Failure::usage(format!("settings file {}: {what}", path.display())).help("see `ironbird fly --print-config`")
    };
    let mut given: Table = text.parse().map_err(|e: toml::de::Error| here(e.to_string()))?;
    for (section, keys) in &mut given {
        let known = default.get(section).and_then(Value::as_table);
        let Some(known) = known else {
            return Err(here(format!("unknown section [{section}]{}", nearest(section, default.keys()))));
        };
        let Some(keys) = keys.as_table_mut() else {
            return Err(here(format!("`{section}` must be a section: [{section}]")));
        };
        for (key, value) in keys {
            let Some(expected) = known.get(key) else {
                return Err(here(format!("unknown key `{section}.{key}`{}", nearest(key, known.keys()))));
            };
            *value = coerce(value, expected).ok_or_else(|| {
                here(format!("{section}.{key} = {value}: expected {}, as in {expected}", kind(expected)))
            })?;
        }
    }
    Ok(given)
}

/// The text of a regular file of at most 1 MiB: a device may have no end, and a pipe may have no writer.
fn text_of(path: &Path) -> io::Result<String> {
    const MOST_BYTES: u64 = 1 << 20;
    let mut text = String::new();
    open_file(path)?.take(MOST_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(io::Error::other("it is longer than 1 MiB"));
    }
    Ok(text)
}

/// The value as the type that is expected: whole numbers also stand for fractional ones.
fn coerce(value: &Value, expected: &Value) -> Option<Value> {
    match (value, expected) {
        (Value::Integer(i), Value::Float(_)) => Some(Value::Float(*i as f64)),
        // "auto", or a number: of a processor, of microseconds.
        (Value::Integer(_), Value::String(auto)) if auto == "auto" => Some(value.clone()),
        (Value::Array(values), Value::Array(expected)) => match expected.first() {
            Some(first) if values.len() == expected.len() => {
                values.iter().map(|value| coerce(value, first)).collect::<Option<Vec<_>>>().map(Value::Array)
            }
            Some(_) => None,
            None => values.iter().all(Value::is_str).then(|| value.clone()),
        },
        _ => value.same_type(expected).then(|| value.clone()),
    }
}

fn kind(expected: &Value) -> String {
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

fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a String>) -> String {
    known
        .max_by(|a, b| strsim::jaro_winkler(a, name).total_cmp(&strsim::jaro_winkler(b, name)))
        .map_or_else(String::new, |nearest| format!("; did you mean `{nearest}`?"))
}

/// Whether two values mean the same, however they are written.
pub(super) fn same(a: &toml_edit::Value, b: &toml_edit::Value) -> bool {
    let number = |v: &toml_edit::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match (a, b) {
        (toml_edit::Value::Array(a), toml_edit::Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b.iter()).all(|(a, b)| same(a, b))
        }
        _ => match (number(a), number(b)) {
            (Some(a), Some(b)) => a == b,
            _ => a.as_str() == b.as_str() && a.as_bool() == b.as_bool(),
        },
    }
}
