//! Refuses settings that were made for one flight and are named for another.
//!
//! A few keys in a settings file are meant: they go before the airframe's own. Whole sections are not: they come from
//! settings that were printed, or left by a flight, and would fly one airframe with the mass, the rotors and the gains
//! of another, without a word (docs/airframes.md).

use std::path::Path;

use failure::Failure;
use model::role::Role;
use toml::{Table, Value};

use super::airframe::PAPER;
use super::laws::{self, Chosen};
use super::layers::beside;

/// Sections that say of themselves which airframe they were made for, where they are whole.
const OF_ONE_AIRFRAME: [&str; 3] = ["airframe", "plant", "model"];
/// Sections that go before what the flag names.
const KEPT: [&str; 6] = ["plant", "model", "rotor", "outer", "inner", "mixer"];
/// Key of `[flight]` with the SHA-256 of the airframe's file.
const SUM: &str = "airframe_sha256";

/// Refuses whole sections of a settings file beside a flag that names another airframe than the file.
///
/// # Errors
/// A usage [`Failure`] names the sections, both airframes and what to do.
pub(super) fn check_airframe(
    file: Option<&Path>,
    given: &Table,
    default: &Table,
    flag: Option<&str>,
) -> Result<(), Failure> {
    let named = text(given, "flight", "airframe").unwrap_or(PAPER);
    let Some(flag) = flag.filter(|flag| *flag != named) else { return Ok(()) };
    let kept: Vec<&str> = KEPT.into_iter().filter(|section| is_whole(given, default, section)).collect();
    if kept.is_empty() || !OF_ONE_AIRFRAME.iter().any(|section| is_whole(given, default, section)) {
        return Ok(());
    }
    Err(mixed(file, &kept, ("airframe", named), ("airframe", flag)))
}

/// Refuses whole sections of laws in a settings file beside a flag that names another preset than the file.
///
/// # Errors
/// As [`check_airframe`].
pub(super) fn check_preset(
    file: Option<&Path>,
    given: &Table,
    default: &Table,
    flag: Option<&str>,
) -> Result<(), Failure> {
    let named = text(given, "flight", "preset").unwrap_or(laws::DEFAULT_PRESET);
    let Some(flag) = flag.filter(|flag| *flag != named) else { return Ok(()) };
    let has_settings = |section: &&str| table(given, section).is_some_and(|keys| keys.keys().any(|key| is_laws(key)));
    let of_laws = laws::SECTIONS.into_iter().map(|(section, _)| section);
    let kept: Vec<&str> = of_laws.filter(|section| is_whole(given, default, section)).filter(has_settings).collect();
    if kept.is_empty() {
        return Ok(());
    }
    Err(mixed(file, &kept, ("preset", named), ("preset", flag)))
}

/// Refuses the settings of a law that a settings file names beside a flag that names another one. Where the file has
/// none but the law's name, its sum is forgotten with it.
///
/// # Errors
/// As [`check_airframe`].
pub(super) fn check_law(file: Option<&Path>, given: &mut Table, section: &str, flag: Chosen) -> Result<(), Failure> {
    let Some(keys) = given.get_mut(section).and_then(Value::as_table_mut) else { return Ok(()) };
    let Some(named) = keys.get(laws::LAW).map(|law| beside(file, law)) else { return Ok(()) };
    let Some(named) = named.as_str().filter(|named| !flag.is_named(named)) else { return Ok(()) };
    if keys.keys().any(|key| is_laws(key)) {
        return Err(mixed(file, &[section], ("law", named), (section, &flag.named())));
    }
    keys.remove(laws::SHA256);
    Ok(())
}

/// Whether a key of a law's section is the law's own.
fn is_laws(key: &str) -> bool {
    ![laws::LAW, laws::SHA256].contains(&key)
}

/// Whether a section has every key that it can have.
fn is_whole(given: &Table, default: &Table, section: &str) -> bool {
    let (Some(given), Some(known)) = (table(given, section), table(default, section)) else { return false };
    known.keys().all(|key| key == laws::LAW || given.contains_key(key))
}

/// Says which sections are whose, and what the flag names instead; beside sections that are in no file, the argument.
fn mixed(file: Option<&Path>, sections: &[&str], (kind, named): (&str, &str), (key, other): (&str, &str)) -> Failure {
    let all = sections.iter().map(|section| format!("[{section}]")).collect::<Vec<_>>().join(", ");
    let (what, them) = match sections.len() {
        1 => (format!("its section {all} is"), "it"),
        _ => (format!("its whole sections {all} are"), "them"),
    };
    let said = |place: &str, said: &str| {
        Failure::usage(format!("{place}: {what} of the {kind} `{named}`, and would go before those of {said}"))
    };
    let Some(path) = file else {
        return said("settings", &format!("{key}=\"{other}\""))
            .help(format!("take {them} out of the settings, or fly without {key}=\"{other}\""));
    };
    let flag = format!("--{key} {other}");
    said(&format!("settings file {}", path.display()), &flag).help(format!(
        "take {them} out of the file, or begin with those of this {kind}: ironbird fly {flag} --print-config"
    ))
}

/// Refuses the settings of a law beside a law that the rig does not know, as [`Settings::of`] does beside one it knows.
///
/// # Errors
/// A usage [`Failure`] names the section, both laws and what to do.
///
/// [`Settings::of`]: super::Settings::of
pub fn check_foreign_law(role: Role, section: &Table, other: &str) -> Result<(), Failure> {
    let Some(named) = section.get(laws::LAW).and_then(Value::as_str) else { return Ok(()) };
    match section.keys().any(|key| is_laws(key)) {
        true => Err(mixed(None, &[role.name()], ("law", named), (role.name(), other))),
        false => Ok(()),
    }
}

/// The SHA-256 that a settings file has of its airframe's file; empty where it has none.
pub(super) fn kept_sum(given: &Table) -> String {
    text(given, "flight", SUM).unwrap_or_default().to_owned()
}

/// Refuses an airframe file that is no longer the one that the settings were made for. A flag may name another.
///
/// # Errors
/// A usage [`Failure`] has both sums.
pub(super) fn check_sum(given: &Table, flag: Option<&str>, name: &str, sha256: &str) -> Result<(), Failure> {
    let wanted = kept_sum(given);
    let is_another = flag.is_some_and(|flag| text(given, "flight", "airframe") != Some(flag));
    if is_another || wanted.is_empty() || wanted == sha256 {
        return Ok(());
    }
    let found = if sha256.is_empty() { "is built in".to_owned() } else { format!("has the SHA-256 {sha256}") };
    Err(Failure::usage(format!("airframe {name} {found}, but the settings were made for a file with {wanted}"))
        .help("bring the old file back, or take flight.airframe_sha256 out of the settings"))
}

/// Takes the sums out of a file's settings that belong to another airframe or trajectory than what is flown.
pub(super) fn forget_sums(given: &mut Table, trajectory: Option<&str>) {
    let is_another = trajectory.is_some_and(|flag| text(given, "flight", "trajectory") != Some(flag));
    let mut forget = |section: &str, key: &str| {
        given.get_mut(section).and_then(Value::as_table_mut).and_then(|section| section.remove(key));
    };
    // That of the airframe's file is known from the file itself.
    forget("flight", SUM);
    if is_another {
        forget("trajectory", "sha256");
    }
}

fn table<'a>(of: &'a Table, section: &str) -> Option<&'a Table> {
    of.get(section).and_then(Value::as_table)
}

fn text<'a>(of: &'a Table, section: &str, key: &str) -> Option<&'a str> {
    table(of, section)?.get(key).and_then(Value::as_str)
}
