//! Settings that the command line sets one by one: `--set inner.alpha_1_s=150`, `--inner adaptive:soft,alpha_1_s=150`.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

use errors::{Failure, TOO_LARGE, of_toml};
use messages::role::Role;
use toml::{Table, Value};

/// Keys of the settings that are set on the command line, with their values; a later flag overrides an earlier one.
///
/// A key that the user typed follows the name of its flag and a space, for errors: `--set inner.alpha_1_s`.
pub type Overrides = Vec<(&'static str, Value)>;

/// Key that selects the preset of one law; it is no setting.
pub(super) const PRESET: &str = "preset";

/// The name of the flag and the key of an override; no name if the flag stands for this key alone.
pub fn parts(flag: &'static str) -> (Option<&'static str>, &'static str) {
    match flag.split_once(' ') {
        Some((flag, key)) => (Some(flag), key),
        None => (None, flag),
    }
}

/// The value of a key, by whichever flag it was given last.
pub fn value_of<'a>(given: &'a Overrides, key: &str) -> Option<&'a Value> {
    let last = given.iter().rfind(|(flag, _)| parts(flag).1 == key);
    last.map(|(_, value)| value)
}

/// Refuses a key that the same flag gives twice, as no order between the values is agreed.
pub(super) fn check_twice<K: Display + Ord + Clone, V: Display>(
    given: impl IntoIterator<Item = (K, V)>,
) -> Result<(), Failure> {
    let mut seen = BTreeMap::new();
    for (key, value) in given {
        if let Some(first) = seen.insert(key.clone(), value.to_string()) {
            let what = format!("{key} is given twice: {first} and {value}");
            return Err(Failure::usage(what).help("leave one out"));
        }
    }
    Ok(())
}

/// The value of `SECTION.KEY=VALUE`, by the rules of a settings file; a word needs no quotes.
pub fn set(flag: &str, text: &str) -> Result<(&'static str, Value), String> {
    let set = text.split_once('=').filter(|(key, _)| {
        let parts = key.split_once('.');
        parts.is_some_and(|(section, key)| !section.is_empty() && !key.is_empty())
    });
    let (key, value) = set.ok_or("write SECTION.KEY=VALUE, as in inner.alpha_1_s=150")?;
    let value = as_in_a_file(value)?;
    // Flags last as long as the process.
    let flag = Box::leak(format!("{flag} {key}").into_boxed_str());
    Ok((flag, value))
}

/// A value by the rules of a settings file; a word needs no quotes.
pub fn as_in_a_file(value: &str) -> Result<Value, String> {
    match format!("it = {value}").parse::<Table>() {
        Err(e) if of_toml(e.message()) == TOO_LARGE => Err(TOO_LARGE.into()),
        Ok(mut table) if table.len() == 1 => Ok(table.remove("it").unwrap_or_else(|| value.into())),
        _ => Ok(value.into()),
    }
}

/// The law of a role with settings of its own: `NAME|FILE[:PRESET][,KEY=VALUE...]`.
pub fn law(role: Role, text: &str) -> Result<Overrides, Failure> {
    let key = match role {
        Role::Outer => "outer.law",
        Role::Mixer => "mixer.law",
        _ => "inner.law",
    };
    let (name, own) = name_and_own(text);
    let mut all = vec![(key, Value::from(name))];
    for own in own {
        let with_key = match own.contains('=') {
            true => format!("{role}.{own}"),
            false => format!("{role}.{PRESET}={own}"),
        };
        let set = set(&format!("--{role}"), &with_key).map_err(|_| {
            Failure::usage(format!("--{role} {text}: `{own}` is no setting")).help(
                "write LAW:PRESET,KEY=VALUE, as in adaptive:soft,alpha_1_s=150; either may be left out",
            )
        })?;
        all.push(set);
    }
    let keys = all.iter().map(|(flag, value)| (parts(flag).1, value));
    check_twice(keys).map_err(|failure| failure.append(&format!(" (--{role} {text})")))?;
    Ok(all)
}

/// A law's name or file, and what follows the colon; lists keep their commas.
fn name_and_own(text: &str) -> (&str, Vec<&str>) {
    let Some((name, own)) = text.split_once(':').filter(|_| !Path::new(text).exists()) else {
        return (text, Vec::new());
    };
    let mut depth = 0_i32;
    let parts = own.split(|character| {
        depth += i32::from(character == '[') - i32::from(character == ']');
        character == ',' && depth == 0
    });
    (name, parts.collect())
}

/// What a law's name is shown with: the settings of its own, as they were typed.
pub fn variant(text: &str) -> &str {
    let (name, _) = name_and_own(text);
    &text[name.len()..]
}
