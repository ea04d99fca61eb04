//! Merges the layers of the settings (default, preset, file, flags) and checks the file.

use std::fmt::Display;
use std::io::{self, Read as _};
use std::path::Path;
use std::sync::LazyLock;

use law::law::Rig;
use model::parameters::{self, did_you_mean};
use toml::{Table, Value};

use crate::settings::airframe::{self, Design};
use crate::settings::laws::Moved;
use crate::settings::{DEFAULT, LAWS, Overrides, Settings, laws, mixed};
use failure::{Failure, open_file};

impl Settings {
    /// As [`Self::of`], of sections that stand in a file, beside which relative names of laws are.
    ///
    /// # Errors
    /// As [`Self::resolve`].
    pub fn of_file(given: Table, file: &Path) -> Result<Self, Failure> {
        Self::over(&LAWS, given, Some(file), &Overrides::new())
    }
}

/// The commented default as a table: read once, since a campaign resolves settings for each of its flights.
fn default() -> Result<&'static Table, Failure> {
    static READ: LazyLock<Result<Table, String>> = LazyLock::new(|| DEFAULT.parse().map_err(|e| format!("{e}")));
    READ.as_ref().map_err(|e| Failure::failed(format!("the default is broken: {e}")))
}

/// The same with the paper's airframe laid over it, and that airframe.
fn with_paper() -> Result<&'static (Table, Design), Failure> {
    static LAID: LazyLock<Result<(Table, Design), String>> = LazyLock::new(|| {
        let mut table = default().map_err(|e| e.to_string())?.clone();
        let design = airframe::design(airframe::PAPER, &section(&table, "model")).map_err(|e| e.to_string())?;
        design.lay(&mut table);
        Ok((table, design))
    });
    LAID.as_ref().map_err(|e| Failure::failed(e.clone()))
}

/// The settings as a table: what is given, over the defaults and below what flags set. The file is where it was read.
pub(super) fn layered(mut given: Table, file: Option<&Path>, overrides: &Overrides) -> Result<Table, Failure> {
    let place = file.map(|path| format!(" (settings file {})", path.display())).unwrap_or_default();
    let flag = |key: &str| overrides.iter().find(|(k, _)| *k == key).map(|(_, value)| value);
    let said = |section: &str, key: &str| flag(&format!("{section}.{key}")).or_else(|| given.get(section)?.get(key));
    let mut table = with_paper()?.0.clone();
    let preset = said("flight", "preset").and_then(Value::as_str).unwrap_or(laws::DEFAULT_PRESET).to_owned();
    let mut presets = vec![laws::DEFAULT_PRESET];
    let mut chosen = Vec::new();
    for (section, role) in laws::SECTIONS {
        let law = match flag(&format!("{section}.{}", laws::LAW)) {
            Some(name) => laws::named(role, Some(name), &Moved::new()),
            None => laws::named(role, said(section, laws::LAW).map(|name| beside(file, name)).as_ref(), &Moved::new())
                .map_err(|failure| failure.append(&place)),
        }?;
        let of_law = law.description().presets.iter().map(|preset| preset.name);
        presets.extend(of_law.filter(|name| !presets.contains(name)).collect::<Vec<_>>());
        table.insert(section.into(), Value::Table(laws::section(law, &preset, &Rig::default())));
        chosen.push((section, law));
    }
    if !presets.contains(&preset.as_str()) {
        return Err(Failure::usage(format!(
            "flight.preset: unknown preset `{preset}` of the chosen laws [possible values: {}]{place}",
            presets.join(", ")
        ))
        .help("see `ironbird fly --print-config`"));
    }
    for (section, law) in chosen.iter().filter(|(section, _)| flag(&format!("{section}.{}", laws::LAW)).is_some()) {
        mixed::check_law(file, &mut given, section, *law)?;
    }
    given = checked(file, given, &table)?;
    mixed::check_airframe(file, &given, &table, flag("flight.airframe").and_then(Value::as_str))?;
    mixed::check_preset(file, &given, &table, flag("flight.preset").and_then(Value::as_str))?;
    let Design { airframe, rotor, .. } =
        lay_airframe(&mut table, &mut given, flag("flight.airframe").and_then(Value::as_str), &place)?;
    mixed::forget_sums(&mut given, flag("flight.trajectory").and_then(Value::as_str));
    let rig = Rig { airframe, rotor, ..Rig::default() };
    for (section, law) in &chosen {
        table.insert((*section).into(), Value::Table(laws::section(*law, &preset, &rig)));
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
    for (section, law) in chosen {
        laws::identify(&mut table, section, law);
    }
    Ok(table)
}

/// A law's name as a settings file means it: a relative file is beside it.
pub(super) fn beside(settings: Option<&Path>, name: &Value) -> Value {
    let folder = settings.and_then(Path::parent);
    match name.as_str().filter(|name| law_library::is_file(name)).zip(folder) {
        Some((name, folder)) => Value::from(folder.join(name).to_string_lossy().into_owned()),
        None => name.clone(),
    }
}

/// Lays the airframe over the defaults: that of the flag, or that of the settings file, or the paper's.
///
/// A section `[airframe]` of the file goes before the name in it: where it is whole, as in the settings of a flight, no
/// other file is read. A flag goes before both.
fn lay_airframe(table: &mut Table, given: &mut Table, flag: Option<&str>, place: &str) -> Result<Design, Failure> {
    let kept = given.remove("airframe").and_then(|kept| kept.as_table().cloned()).filter(|_| flag.is_none());
    let named = given.get("flight").and_then(|flight| flight.get("airframe")).and_then(Value::as_str);
    let mut values = section(table, "airframe");
    let is_whole = kept.as_ref().is_some_and(|kept| kept.len() == values.len());
    let name = flag.or(named).filter(|_| !is_whole).unwrap_or(airframe::PAPER).to_owned();
    let mut design = match name.as_str() {
        airframe::PAPER => with_paper()?.1.clone(),
        name => airframe::design(name, &section(table, "model"))?,
    };
    if is_whole {
        let rotor = section(given, "rotor");
        if !["min_rad_s", "max_rad_s"].iter().all(|key| rotor.contains_key(*key)) {
            return Err(Failure::usage(format!("a whole section [airframe] has its own rotors{place}"))
                .help("write them beside it: [rotor] with min_rad_s and max_rad_s"));
        }
        design.sha256 = mixed::kept_sum(given);
    } else {
        mixed::check_sum(given, flag, &name, &design.sha256)?;
    }
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

/// A section of the settings.
pub(super) fn section(table: &Table, name: &str) -> Table {
    table.get(name).and_then(Value::as_table).cloned().unwrap_or_default()
}

/// What is wrong with the settings that are given, and where.
fn here(file: Option<&Path>, what: impl Display) -> Failure {
    let place = file.map_or_else(|| "settings".into(), |path| format!("settings file {}", path.display()));
    Failure::usage(format!("{place}: {what}")).help("see `ironbird fly --print-config`")
}

/// A settings file.
pub(super) fn read(path: &Path) -> Result<Table, Failure> {
    let text = text_of(path).map_err(|e| {
        Failure::usage(format!("cannot read the settings file {}: {e}", path.display()))
            .help("name a file that you can read; `ironbird fly --print-config` writes one to begin with")
    })?;
    text.parse().map_err(|e: toml::de::Error| match e.span().filter(|_| e.message().contains("integer `")) {
        Some(span) => here(Some(path), format!("line {}: {BEYOND}", airframe::line_of(&text, &span))),
        None => here(Some(path), e),
    })
}

/// What the format cannot read.
const BEYOND: &str = "a whole number beyond 9223372036854775807 cannot be read";

/// What is given: every key must be known, and of the type that the default has.
fn checked(file: Option<&Path>, mut given: Table, default: &Table) -> Result<Table, Failure> {
    let here = |what: String| here(file, what);
    for (section, keys) in &mut given {
        if let Some(moved) = keys.as_table().and_then(|keys| laws::moved(section, keys)) {
            return Err(here(moved));
        }
        let known = default.get(section).and_then(Value::as_table);
        let Some(known) = known else {
            return Err(here(format!("unknown section [{section}]{}", nearest(section, default.keys()))));
        };
        let Some(keys) = keys.as_table_mut() else {
            return Err(here(format!("`{section}` must be a section: [{section}]")));
        };
        for (key, value) in keys {
            let Some(expected) = known.get(key) else {
                let of = known.get(laws::LAW).map(|law| format!(" of the law {law}")).unwrap_or_default();
                return Err(here(format!("unknown key `{section}.{key}`{of}{}", nearest(key, known.keys()))));
            };
            *value = coerce(value, expected).ok_or_else(|| {
                here(format!("{section}.{key} = {value}: expected {}, as in {}", kind(expected), example(expected)))
            })?;
        }
    }
    Ok(given)
}

/// What is said beside the settings: of the type that the default has.
pub(super) fn typed(overrides: &Overrides) -> Result<Overrides, Failure> {
    let default = default()?;
    let typed = |(key, value): &(&'static str, Value)| {
        let known = key.split_once('.').and_then(|(section, key)| default.get(section)?.get(key));
        // A law's name is looked at where the law is found.
        let Some(expected) = known else { return Ok((*key, value.clone())) };
        coerce(value, expected).map(|value| (*key, value)).ok_or_else(|| {
            here(None, format!("{key} = {value}: expected {}, as in {}", kind(expected), example(expected)))
        })
    };
    overrides.iter().map(typed).collect()
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
pub(super) fn coerce(value: &Value, expected: &Value) -> Option<Value> {
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
fn example(expected: &Value) -> String {
    match expected {
        Value::Array(values) if values.is_empty() => "[\"mass_kg=0.6@8s\"]".into(),
        other => other.to_string(),
    }
}

pub(super) fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a String>) -> String {
    did_you_mean(parameters::nearest(name, known.map(String::as_str)))
}

/// Names, the nearest to what was typed first.
pub fn nearest_first(name: &str, mut known: Vec<&str>) -> String {
    known.sort_by(|a, b| strsim::jaro_winkler(b, name).total_cmp(&strsim::jaro_winkler(a, name)));
    known.join(", ")
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
