//! Merges the layers of the settings (default, preset, file, flags) and checks the file.

use std::io::{self, Read as _};
use std::path::Path;

use controller::{Gains, Limits, Preset};
use model::parameters::Airframe;
use toml::{Table, Value};

use crate::settings::airframe::{self, Design};
use crate::settings::{DEFAULT, Overrides};
use failure::{Failure, open_file};

/// The settings as a table, and the file that had a part in them.
pub(super) fn layered<'a>(file: Option<&'a Path>, overrides: &Overrides) -> Result<(Table, Option<&'a Path>), Failure> {
    let mut table: Table = DEFAULT.parse().map_err(|e| Failure::failed(format!("the default is broken: {e}")))?;
    airframe::design(airframe::PAPER, &section(&table, "model"))?.lay(&mut table);
    let mut given = file.map(|path| read(path, &table)).transpose()?.unwrap_or_default();
    let flag = |key: &str| overrides.iter().find(|(k, _)| *k == key).map(|(_, value)| value);
    let design = lay_airframe(&mut table, &mut given, flag("flight.airframe").and_then(Value::as_str))?;
    let preset = flag("flight.preset").or_else(|| given.get("flight")?.get("preset")).and_then(Value::as_str);
    let preset = preset.map_or(Ok(Preset::Flight), str::parse).map_err(|e| {
        // A flag with an unknown name does not come this far.
        let place = file.map(|path| format!(" (settings file {})", path.display())).unwrap_or_default();
        Failure::usage(format!("flight.preset: {e}{place}")).help("see `ironbird fly --print-config`")
    })?;
    lay_gains(&mut table, preset, &design)?;
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

/// Lays the airframe over the defaults: that of the flag, or that of the settings file, or the paper's.
///
/// A section `[airframe]` of the file goes before the name in it: where it is whole, as in the settings of a flight, no
/// other file is read. A flag goes before both.
fn lay_airframe(table: &mut Table, given: &mut Table, flag: Option<&str>) -> Result<Design, Failure> {
    let model = section(table, "model");
    let kept = given.remove("airframe").and_then(|kept| kept.as_table().cloned()).filter(|_| flag.is_none());
    let named = given.get("flight").and_then(|flight| flight.get("airframe")).and_then(Value::as_str);
    let mut values = section(table, "airframe");
    let is_whole = kept.as_ref().is_some_and(|kept| kept.len() == values.len());
    let name = flag.or(named).filter(|_| !is_whole).unwrap_or(airframe::PAPER);
    let mut design = airframe::design(name, &model)?;
    if let Some(kept) = kept {
        design.lay(table);
        values = section(table, "airframe");
        values.extend(kept);
        let values = values.into_iter().filter_map(|(name, value)| Some((name, value.as_float()?))).collect();
        design.airframe = airframe::built(&values)
            .map_err(|e| Failure::usage(format!("airframe: {e}")).help("see `ironbird params`"))?;
    }
    design.lay(table);
    Ok(design)
}

/// Lays the gains of a preset and the limits over the defaults, as they suit the airframe.
fn lay_gains(table: &mut Table, preset: Preset, design: &Design) -> Result<(), Failure> {
    let Design { airframe, rotor, .. } = design;
    let gains = Gains::preset(preset).scaled(&Airframe::nominal(), airframe);
    let limits = Limits::default().scaled(airframe, rotor);
    let written = |e: toml::ser::Error| Failure::failed(e.to_string());
    table.insert("gains".into(), Value::Table(Table::try_from(gains).map_err(written)?));
    table.insert("limits".into(), Value::Table(Table::try_from(limits).map_err(written)?));
    Ok(())
}

/// A section of the settings.
pub(super) fn section(table: &Table, name: &str) -> Table {
    table.get(name).and_then(Value::as_table).cloned().unwrap_or_default()
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
pub(super) fn text_of(path: &Path) -> io::Result<String> {
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

pub(super) fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a String>) -> String {
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
