//! Reads a library's table: everything is checked, and its words are copied.
#![allow(
    unsafe_code,
    reason = "a foreign table is read; each use says what is promised"
)]

use std::ffi::c_char;
use std::slice;

use control_api::description::TICK;
use ironbird_law::abi::{
    IRONBIRD_INNER, IRONBIRD_LAW_INTERFACE, IRONBIRD_MIXER, IRONBIRD_MOST_PRESETS,
    IRONBIRD_MOST_SETTINGS, IRONBIRD_MOST_WORDS, IRONBIRD_NAME_BYTES, IRONBIRD_NUMBER,
    IRONBIRD_OUTER, IRONBIRD_TEXT_BYTES, IRONBIRD_THREE, IRONBIRD_WORD, IronbirdLaw,
    IronbirdPreset, IronbirdSetting, IronbirdSignal, IronbirdSizes,
};
use messages::role::Role;
use messages::telemetry::TELEMETRY;

use crate::answer::{Answer, Kind, PresetValue};

/// Keys of a law's section that are the rig's.
const RIGS_KEYS: &[&str] = &["law", "sha256"];

/// A copy of a table, and what it says in words, all of which is allowed.
pub(crate) fn described(
    table: *const IronbirdLaw,
) -> Result<(&'static IronbirdLaw, Answer), String> {
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
    unlike(settings.iter().map(|it| &it.0[0]), RIGS_KEYS, "setting")?;
    let (first, count) = (table.presets, table.presets_count);
    let read = |it: &_| preset(it, &settings);
    let presets = each(first, count, IRONBIRD_MOST_PRESETS, "preset", read)?;
    unlike(presets.iter().map(|it| &it.0), &[], "preset")?;
    let (first, count) = (table.telemetry, table.telemetry_count);
    let telemetry = each(first, count, TELEMETRY as u64, "signal", signal)?;
    unlike(telemetry.iter().map(|it| &it[0]), &[TICK], "signal")?;
    let answer = Answer {
        role,
        texts: [
            snake_case(table.name, "name")?,
            required_text(table.version, IRONBIRD_NAME_BYTES, "version")?,
            required_text(table.summary, IRONBIRD_TEXT_BYTES, "summary")?,
            text(table.source, IRONBIRD_TEXT_BYTES, "source")?,
        ],
        settings,
        presets,
        telemetry,
        not_real_time: table.not_real_time != 0,
        is_rehearsed: table.copy_into.is_some(),
    };
    answer.description()?;
    Ok((table, answer))
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
) -> Result<Vec<U>, String> {
    let array_name = match name {
        "signal" => "telemetry".to_owned(),
        name => format!("{name}s"),
    };
    let elements = array(first, count, most, &array_name)?.iter().enumerate();
    let read = elements.map(|(i, it)| read(it).map_err(|what| format!("its {name} {i}, {what}")));
    read.collect()
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

fn setting(it: &IronbirdSetting) -> Result<([String; 3], Kind), String> {
    let name = snake_case(it.name, "name")?;
    let named = |what: String| format!("`{name}`: {what}");
    let unit = text(it.unit, IRONBIRD_NAME_BYTES, "unit").map_err(named)?;
    let meaning = required_text(it.meaning, IRONBIRD_TEXT_BYTES, "meaning").map_err(named)?;
    let kind = kind(it).map_err(named)?;
    Ok(([name, unit, meaning], kind))
}

fn kind(it: &IronbirdSetting) -> Result<Kind, String> {
    let (kind, default, min, max) = (it.kind, it.default_number, it.min, it.max);
    if kind == IRONBIRD_WORD {
        let words = array(it.words, it.words_count, IRONBIRD_MOST_WORDS, "words")?;
        let words = words.iter().map(|it| word(*it));
        let words = words.collect::<Result<Vec<_>, _>>()?;
        unlike(&words, &[], "word")?;
        if words.is_empty() {
            return Err("it has no words".into());
        }
        return Ok(Kind::Word(words));
    }
    if !(min.is_finite() && max.is_finite() && min <= max) {
        return Err(format!(
            "min is {min} and max is {max}: expected finite numbers in order; DBL_MAX is no bound"
        ));
    }
    match kind {
        IRONBIRD_NUMBER => Ok(Kind::Number(default[0], min, max)),
        IRONBIRD_THREE => Ok(Kind::Three(default, min, max)),
        other => Err(format!(
            "its kind is {other}: expected IRONBIRD_NUMBER, IRONBIRD_THREE or IRONBIRD_WORD"
        )),
    }
}

fn preset(
    it: &IronbirdPreset,
    settings: &[([String; 3], Kind)],
) -> Result<(String, Vec<PresetValue>), String> {
    let name = snake_case(it.name, "name")?;
    let values = array(
        it.values,
        settings.len() as u64,
        IRONBIRD_MOST_SETTINGS,
        "values",
    )?;
    let values = values.iter().zip(settings).map(|(it, (_, kind))| {
        // Numbers that a setting of its kind does not use may be anything, and NaN is no JSON.
        let used = match kind {
            Kind::Number(..) => 1,
            Kind::Three(..) => 3,
            Kind::Word(_) => 0,
        };
        let number = |i: usize| if i < used { it.number[i] } else { 0.0 };
        ([0, 1, 2].map(number), it.word)
    });
    Ok((name, values.collect()))
}

fn signal(it: &IronbirdSignal) -> Result<[String; 2], String> {
    let name = snake_case(it.name, "name")?;
    let unit = text(it.unit, IRONBIRD_NAME_BYTES, "unit");
    let unit = unit.map_err(|what| format!("`{name}`: {what}"))?;
    Ok([name, unit])
}

/// Names must differ, also from those that are the rig's.
fn unlike<'a>(
    names: impl IntoIterator<Item = &'a String>,
    rigs: &[&str],
    what: &str,
) -> Result<(), String> {
    let mut seen = Vec::new();
    for name in names {
        if rigs.contains(&name.as_str()) {
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
fn snake_case(at: *const c_char, field: &str) -> Result<String, String> {
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

fn word(at: *const c_char) -> Result<String, String> {
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

fn required_text(at: *const c_char, most: u64, field: &str) -> Result<String, String> {
    let text = text(at, most, field)?;
    if text.is_empty() {
        Err(format!("its {field} is missing"))
    } else {
        Ok(text)
    }
}

/// A text of one line; NULL is none.
fn text(at: *const c_char, most: u64, field: &str) -> Result<String, String> {
    if at.is_null() {
        return Ok(String::new());
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
        None => Ok(text.to_owned()),
    }
}
