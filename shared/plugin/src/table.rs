//! Reads a library's table: everything is checked, and its words are copied.
#![allow(
    unsafe_code,
    reason = "a foreign table is read; each use says what is promised"
)]

use std::ffi::c_char;
use std::slice;

use control_api::description::{Description, Preset, Setting, SettingKind, Signal, TICK};
use ironbird_law::abi::{
    IRONBIRD_INNER, IRONBIRD_LAW_INTERFACE, IRONBIRD_MIXER, IRONBIRD_MOST_PRESETS,
    IRONBIRD_MOST_SETTINGS, IRONBIRD_MOST_WORDS, IRONBIRD_NAME_BYTES, IRONBIRD_NUMBER,
    IRONBIRD_OUTER, IRONBIRD_TEXT_BYTES, IRONBIRD_THREE, IRONBIRD_WORD, IronbirdLaw,
    IronbirdPreset, IronbirdSetting, IronbirdSignal, IronbirdSizes, IronbirdValue,
};
use messages::role::Role;
use messages::telemetry::TELEMETRY;

/// Keys of a law's section that are the rig's.
const RIGS_KEYS: &[&str] = &["law", "sha256"];

/// A copy of a table, and what it says in words.
pub(crate) type Described = (&'static IronbirdLaw, &'static Description);

pub(crate) fn described(table: *const IronbirdLaw) -> Result<Described, String> {
    let table = checked(table)?;
    let (role, tick) = match table.role {
        IRONBIRD_OUTER => (Role::Outer, ("tick_outer", table.tick_outer.is_some())),
        IRONBIRD_INNER => (Role::Inner, ("tick_inner", table.tick_inner.is_some())),
        IRONBIRD_MIXER => (Role::Mixer, ("tick_mixer", table.tick_mixer.is_some())),
        other => {
            return Err(format!(
                "its role is {other}: expected IRONBIRD_OUTER, IRONBIRD_INNER or IRONBIRD_MIXER"
            ));
        }
    };
    let create = ("create", table.create.is_some());
    let destroy = ("destroy", table.destroy.is_some());
    let mut functions = [create, destroy, tick].into_iter();
    if let Some((name, _)) = functions.find(|(_, is_there)| !is_there) {
        return Err(format!("its function `{name}` is NULL"));
    }
    if table.save.is_some() != table.load.is_some() {
        return Err("one of its functions `save` and `load` is NULL: give both, or neither".into());
    }
    let (first, count) = (table.settings, table.settings_count);
    let settings = each(first, count, IRONBIRD_MOST_SETTINGS, "setting", setting)?;
    unlike(settings.iter().map(|it| it.name), RIGS_KEYS, "setting")?;
    let (first, count) = (table.presets, table.presets_count);
    let read = |it: &_| preset(it, settings);
    let presets = each(first, count, IRONBIRD_MOST_PRESETS, "preset", read)?;
    unlike(presets.iter().map(|it| it.name), &[], "preset")?;
    let (first, count) = (table.telemetry, table.telemetry_count);
    let telemetry = each(first, count, TELEMETRY as u64, "signal", signal)?;
    unlike(telemetry.iter().map(|it| it.name), &[TICK], "signal")?;
    let description = Description {
        name: snake_case(table.name, "name")?,
        role,
        version: required_text(table.version, IRONBIRD_NAME_BYTES, "version")?,
        summary: required_text(table.summary, IRONBIRD_TEXT_BYTES, "summary")?,
        source: text(table.source, IRONBIRD_TEXT_BYTES, "source")?,
        settings,
        presets,
        suited: None,
        telemetry,
    };
    Ok((table, Box::leak(Box::new(description))))
}

/// A copy of the table, if it is one of this interface.
fn checked(table: *const IronbirdLaw) -> Result<&'static IronbirdLaw, String> {
    if table.is_null() {
        return Err("its function `ironbird_law` returned NULL: expected the law's table".into());
    }
    if !table.is_aligned() {
        return Err(
            "its function `ironbird_law` returned an odd address: expected the law's table".into(),
        );
    }
    // SAFETY: the version and the sizes stand first in every version of the interface.
    let (version, sizes) = unsafe { ((*table).interface_version, (*table).sizes) };
    if version != IRONBIRD_LAW_INTERFACE {
        return Err(format!(
            "it was built for version {version} of the interface, and this ironbird has version \
             {IRONBIRD_LAW_INTERFACE}: build it again with the ironbird_law.h of this ironbird"
        ));
    }
    let here = IronbirdSizes::HERE;
    if sizes != here {
        return Err(format!(
            "its structs have other sizes than those of this ironbird: they are {sizes:?}, and should be {here:?}; set \
             `.sizes = IRONBIRD_SIZES`, and leave the packing of structs to the compiler"
        ));
    }
    // SAFETY: the library says that its table is such a struct.
    Ok(Box::leak(Box::new(unsafe { *table })))
}

/// The elements of an array of the table, read one by one.
fn each<T: 'static, U>(
    first: *const T,
    count: u64,
    most: u64,
    name: &str,
    read: impl Fn(&T) -> Result<U, String>,
) -> Result<&'static [U], String> {
    let array_name = match name {
        "signal" => "telemetry".to_owned(),
        name => format!("{name}s"),
    };
    let elements = array(first, count, most, &array_name)?.iter().enumerate();
    let read = elements.map(|(i, it)| read(it).map_err(|what| format!("its {name} {i}, {what}")));
    Ok(read.collect::<Result<Vec<_>, _>>()?.leak())
}

fn array<T>(first: *const T, count: u64, most: u64, name: &str) -> Result<&'static [T], String> {
    if count > most {
        return Err(format!(
            "its {name}_count is {count}: allowed are up to {most}"
        ));
    }
    if count == 0 {
        return Ok(&[]);
    }
    if first.is_null() || !first.is_aligned() {
        return Err(format!(
            "its {name}_count is {count}, and `{name}` is no array"
        ));
    }
    // SAFETY: the library says that so many stand there, and that they stay as they are.
    Ok(unsafe { slice::from_raw_parts(first, count as usize) })
}

fn setting(it: &IronbirdSetting) -> Result<Setting, String> {
    let name = snake_case(it.name, "name")?;
    let named = |what: String| format!("`{name}`: {what}");
    let setting = Setting {
        name,
        unit: text(it.unit, IRONBIRD_NAME_BYTES, "unit").map_err(named)?,
        meaning: required_text(it.meaning, IRONBIRD_TEXT_BYTES, "meaning").map_err(named)?,
        kind: kind(it).map_err(named)?,
    };
    let default = setting.default();
    if setting.allows(&default) {
        return Ok(setting);
    }
    Err(format!(
        "`{name}`: its default is {default:?}, and allowed is {}",
        setting.allowed()
    ))
}

fn kind(it: &IronbirdSetting) -> Result<SettingKind, String> {
    let (kind, default, min, max) = (it.kind, it.default_number, it.min, it.max);
    if kind == IRONBIRD_WORD {
        let words = array(it.words, it.words_count, IRONBIRD_MOST_WORDS, "words")?;
        let words = words.iter().map(|it| word(*it));
        let words = words.collect::<Result<Vec<_>, _>>()?.leak();
        unlike(words.iter().copied(), &[], "word")?;
        if words.is_empty() {
            return Err("it has no words".into());
        }
        return Ok(SettingKind::Word(words));
    }
    if !(min.is_finite() && max.is_finite() && min <= max) {
        return Err(format!(
            "min is {min} and max is {max}: expected finite numbers in order; DBL_MAX is no bound"
        ));
    }
    match kind {
        IRONBIRD_NUMBER => {
            let default = default[0];
            Ok(SettingKind::Number { default, min, max })
        }
        IRONBIRD_THREE => Ok(SettingKind::Three { default, min, max }),
        other => Err(format!(
            "its kind is {other}: expected IRONBIRD_NUMBER, IRONBIRD_THREE or IRONBIRD_WORD"
        )),
    }
}

fn preset(it: &IronbirdPreset, settings: &'static [Setting]) -> Result<Preset, String> {
    let name = snake_case(it.name, "name")?;
    let count = settings.len() as u64;
    let values = array(it.values, count, IRONBIRD_MOST_SETTINGS, "values")?;
    let value = |(setting, it): (&'static Setting, &IronbirdValue)| {
        let value = setting.from_abi(it);
        match setting.allows(&value) {
            true => Ok((setting.name, value)),
            false => Err(format!(
                "`{name}`: its {} is {value:?}: allowed is {}",
                setting.name,
                setting.allowed()
            )),
        }
    };
    let values = settings.iter().zip(values).map(value);
    let values = values.collect::<Result<Vec<_>, _>>()?.leak();
    Ok(Preset { name, values })
}

fn signal(it: &IronbirdSignal) -> Result<Signal, String> {
    let name = snake_case(it.name, "name")?;
    Ok(Signal {
        name,
        unit: text(it.unit, IRONBIRD_NAME_BYTES, "unit")
            .map_err(|what| format!("`{name}`: {what}"))?,
    })
}

/// Names must differ, also from those that are the rig's.
fn unlike(
    names: impl Iterator<Item = &'static str>,
    rigs: &[&str],
    what: &str,
) -> Result<(), String> {
    let mut seen: Vec<&str> = Vec::new();
    for name in names {
        if rigs.contains(&name) {
            return Err(format!(
                "it has the {what} `{name}`, which is the rig's own"
            ));
        }
        if seen.contains(&name) {
            return Err(format!("it has the {what} `{name}` twice"));
        }
        seen.push(name);
    }
    Ok(())
}

/// A name as users type it.
fn snake_case(at: *const c_char, field: &str) -> Result<&'static str, String> {
    let name = required_text(at, IRONBIRD_NAME_BYTES, field)?;
    let is_name = name.starts_with(|c: char| c.is_ascii_lowercase())
        && name
            .chars()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    if is_name {
        return Ok(name);
    }
    Err(format!(
        "its {field} is `{name}`: expected lower-case letters, digits and _, with a letter first"
    ))
}

fn word(at: *const c_char) -> Result<&'static str, String> {
    let word = required_text(at, IRONBIRD_NAME_BYTES, "word")?;
    let is_word = word
        .chars()
        .all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c));
    if is_word {
        return Ok(word);
    }
    Err(format!(
        "its word is `{word}`: expected letters, digits, `_`, `-` and `.`"
    ))
}

fn required_text(at: *const c_char, most: u64, field: &str) -> Result<&'static str, String> {
    let text = text(at, most, field)?;
    if text.is_empty() {
        Err(format!("its {field} is missing"))
    } else {
        Ok(text)
    }
}

/// A text of one line; NULL is none.
fn text(at: *const c_char, most: u64, field: &str) -> Result<&'static str, String> {
    if at.is_null() {
        return Ok("");
    }
    // SAFETY: the library says that a NUL ends the text; no byte behind it is read.
    let length = unsafe { libc::strnlen(at, most as usize + 1) };
    if length as u64 > most {
        return Err(format!("its {field} is longer than {most} bytes"));
    }
    // SAFETY: so many bytes were read.
    let bytes = unsafe { slice::from_raw_parts(at.cast::<u8>(), length) };
    let text = std::str::from_utf8(bytes).map_err(|e| format!("its {field} is not UTF-8: {e}"))?;
    match text.chars().find(|c| c.is_control()) {
        Some(c) => Err(format!(
            "its {field} has the character {c:?}: expected one line of text"
        )),
        None => Ok(text.to_owned().leak()),
    }
}
