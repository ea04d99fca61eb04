//! The laws of a flight: a section of the settings for each, whose keys are the law's own.
//!
//! A law is built in, or that of a file. The roles share the SHA-256 of the file: each loads it itself, and one whose
//! file differs is refused by both sums.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use control_api::description::{self, Description, Setting, SettingKind, Value as LawValue};
use control_api::law::Rig;
use control_api::registry::Entry;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use plugin::Library;
use toml::{Table, Value};

pub use super::toml_access::meant_or_known;
use super::toml_access::{coerce, kind, utf8};
use analysis::laws::NotFinite;
use analysis::schema::{LawSection, SignalSection};
use errors::Failure;

/// The key that names the law; the others are the law's.
pub const LAW: &str = "law";

/// The key beside it that names the content of its file, where it is that of a file.
pub const SHA256: &str = "sha256";

/// The preset that is no choice: the defaults of each law.
pub const DEFAULT_PRESET: &str = "flight";

const EXPLAINED: &str = "`ironbird laws` lists the laws, `ironbird laws NAME` explains one";

/// The descriptions of a role's built-in laws; the first one is the default. None for another role.
pub fn known(role: Role) -> Vec<&'static Description> {
    fn all<L: ?Sized>(entries: &[Entry<L>]) -> Vec<&'static Description> {
        entries.iter().map(|entry| entry.description).collect()
    }
    match role {
        Role::Outer => all(controller::laws::OUTER),
        Role::Inner => [all(controller::laws::INNER), all(firmware::LAWS)].concat(),
        Role::Mixer => all(mixer::LAWS),
        Role::Plant | Role::Record => Vec::new(),
    }
}

pub fn preset_names() -> Vec<&'static str> {
    presets_of(LAW_ROLES.into_iter().flat_map(known))
}

/// The presets that some laws have: the defaults, then the others.
pub(super) fn presets_of<'a>(laws: impl IntoIterator<Item = &'a Description>) -> Vec<&'a str> {
    let mut names = vec![DEFAULT_PRESET];
    for preset in laws.into_iter().flat_map(|law| law.presets) {
        if !names.contains(&preset.name) {
            names.push(preset.name);
        }
    }
    names
}

#[derive(Clone, Copy, Debug)]
pub enum Chosen {
    BuiltIn(&'static Description),
    Library(&'static Library),
}

impl Chosen {
    pub const fn description(self) -> &'static Description {
        match self {
            Self::BuiltIn(description) => description,
            Self::Library(library) => library.description,
        }
    }

    /// Its file, where it is that of a file.
    pub const fn library(self) -> Option<&'static Library> {
        match self {
            Self::BuiltIn(_) => None,
            Self::Library(library) => Some(library),
        }
    }

    /// Its name, or its file, as `--inner` takes it.
    pub(super) fn named(self) -> String {
        self.library().map_or_else(
            || self.description().name.into(),
            |library| library.file.display().to_string(),
        )
    }

    /// Whether a name, or that of a file, means it.
    pub(super) fn is_named(self, named: &str) -> bool {
        match self {
            Self::BuiltIn(law) => law.name == named,
            Self::Library(library) => library.is_at(Path::new(named)),
        }
    }

    pub fn section(self, not_finite: NotFinite, telemetry: Vec<SignalSection>) -> LawSection {
        let Description { name, version, .. } = *self.description();
        let library = self.library();
        LawSection {
            version: version.into(),
            file: library.map(|library| library.file.to_string_lossy().into_owned()),
            sha256: library.map(|library| library.sha256.clone()),
            not_real_time: library.is_some_and(|library| library.not_real_time),
            ..not_finite.section(name, telemetry)
        }
    }

    /// What its section of the settings says of it, whatever its settings.
    pub(super) fn identity(self) -> Vec<(&'static str, Value)> {
        match self {
            Self::BuiltIn(law) => vec![(LAW, Value::from(law.name))],
            Self::Library(library) => vec![
                (
                    LAW,
                    Value::from(library.file.to_string_lossy().into_owned()),
                ),
                (SHA256, Value::from(library.sha256.clone())),
            ],
        }
    }
}

/// Where the files of laws are now, by the place that the settings name.
pub type Moved = BTreeMap<String, PathBuf>;

/// The law of a role by its name or file; the first one if none is named.
pub(super) fn named(role: Role, name: Option<&Value>, moved: &Moved) -> Result<Chosen, Failure> {
    let known = known(role);
    let Some(name) = name else {
        return Ok(Chosen::BuiltIn(known[0]));
    };
    let refused =
        |what: String| Failure::usage(format!("{role}.{LAW} = {name}: {what}")).help(EXPLAINED);
    let Some(text) = name.as_str() else {
        let example = known[0].name;
        return Err(refused(format!("expected a string, as in \"{example}\"")));
    };
    if plugin::is_file(text) {
        let library = plugin::open(
            role,
            moved.get(text).map_or(Path::new(text), PathBuf::as_path),
        )?;
        utf8(&library.file)?;
        let name = library.description.name;
        let mut built_in = LAW_ROLES.into_iter().flat_map(self::known);
        if built_in.any(|law| law.name == name) {
            return Err(refused(format!(
                "its name is `{name}`, and a law of that name is built in"
            ))
            .help("give it another name: the report and the log tell laws apart by it"));
        }
        return Ok(Chosen::Library(library));
    }
    match known.iter().find(|law| law.name == text) {
        Some(law) => Ok(Chosen::BuiltIn(law)),
        None => Err(refused(format!(
            "there is no {role} law of that name{}",
            meant_or_known(text, &known.iter().map(|law| law.name).collect::<Vec<_>>())
        ))
        .help(format!("{EXPLAINED}; write ./{text} for a file"))),
    }
}

/// A law's section when nothing is said but a preset, as it suits the rig.
pub(super) fn section(chosen: Chosen, preset: &str, rig: &Rig) -> Table {
    let law = chosen.description();
    let preset = law.preset(preset).unwrap_or_default();
    let preset = law
        .suited
        .map_or_else(|| preset.clone(), |suited| suited(&preset, rig));
    let mut table: Table = chosen
        .identity()
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect();
    for setting in law.settings {
        let value = match setting.kind {
            SettingKind::Number { .. } => Value::from(preset.number(setting)),
            SettingKind::Three { .. } => Value::from(preset.three(setting).to_vec()),
            SettingKind::Word(_) => Value::from(preset.word(setting)),
        };
        table.insert(setting.name.to_owned(), value);
    }
    table
}

/// Enters a chosen law's file by its absolute path, so that roles in different folders mean the same; and its sum, if
/// none was given.
pub(super) fn identify(table: &mut Table, section: &str, chosen: Chosen) {
    let Some(Value::Table(keys)) = table.get_mut(section) else {
        return;
    };
    for (key, value) in chosen.identity() {
        let given = keys.get(key).and_then(Value::as_str).unwrap_or_default();
        if key == LAW || given.is_empty() {
            keys.insert(key.into(), value);
        }
    }
}

/// A law with the settings of its section, each of them checked.
pub(super) fn chosen(
    role: Role,
    section: &Table,
    moved: &Moved,
) -> Result<(Chosen, description::Settings), Failure> {
    let refused = |what: String| Failure::usage(format!("settings: {what}")).help(EXPLAINED);
    let chosen = named(role, section.get(LAW), moved)?;
    let law = chosen.description();
    if let Some(library) = chosen.library() {
        check_same(role, &library.file, &library.sha256, section)?;
    }
    let defaults = self::section(chosen, DEFAULT_PRESET, &Rig::default());
    let identity = chosen.identity();
    let is_own = |key: &str| identity.iter().all(|(of_rig, _)| key != *of_rig);
    let mut values = Vec::new();
    for (key, value) in section.iter().filter(|(key, _)| is_own(key)) {
        let setting = law.settings.iter().find(|setting| setting.name == key);
        let setting = setting.ok_or_else(|| {
            let law = law.name;
            refused(format!("{role}.{key}: the law `{law}` has no such setting"))
        })?;
        let expected = &defaults[key];
        let taken = coerce(value, expected).and_then(|value| taken(setting, &value));
        let taken = taken.ok_or_else(|| {
            let kind = kind(expected);
            refused(format!(
                "{role}.{key} = {value}: expected {kind}, as in {expected}"
            ))
        })?;
        if !setting.allows(&taken) {
            return Err(refused(format!(
                "{role}.{key} = {value} is out of range: allowed is {}",
                setting.allowed()
            )));
        }
        values.push((setting.name, taken));
    }
    Ok((chosen, description::Settings::new(values)))
}

/// Refuses the file of a law, with its SHA-256, that is not the one that the settings were made for.
pub fn check_same(role: Role, file: &Path, there: &str, section: &Table) -> Result<(), Failure> {
    let said = |key: &str| section.get(key).and_then(Value::as_str).unwrap_or_default();
    let wanted = said(SHA256);
    if wanted == there {
        return Ok(());
    }
    let (flown, here) = (said(LAW), file.display());
    Err(Failure::usage(format!(
        "the {role} law {here}: its SHA-256 is {there}, but the settings were made for {flown} with {wanted}"
    ))
    .help(format!(
        "it is another file: bring the old one back (`replay --{role} FILE` says where it is), or take {role}.{SHA256} \
         out of the settings"
    )))
}

/// A value of a file as a law's; a word that does not exist is one that is not allowed.
fn taken(setting: &Setting, value: &Value) -> Option<LawValue> {
    match (setting.kind, value) {
        (SettingKind::Number { .. }, Value::Float(number)) => Some(LawValue::Number(*number)),
        (SettingKind::Three { .. }, Value::Array(numbers)) => {
            let numbers: Vec<f64> = numbers.iter().filter_map(Value::as_float).collect();
            numbers.try_into().ok().map(LawValue::Three)
        }
        (SettingKind::Word(words), Value::String(word)) => Some(LawValue::Word(
            words
                .iter()
                .find(|known| *known == word)
                .copied()
                .unwrap_or_default(),
        )),
        _ => None,
    }
}

/// The entry of a law that is known.
pub(super) fn entry<L: ?Sized>(
    entries: &[&'static [Entry<L>]],
    law: &Description,
) -> &'static Entry<L> {
    let mut all = entries.iter().copied().flatten();
    all.find(|entry| entry.description.name == law.name)
        .unwrap_or(&entries[0][0])
}

/// A law's section as text, each key with what it is.
pub(super) fn commented(
    role: Role,
    name: &str,
    section: &Table,
    moved: &Moved,
) -> Result<String, Failure> {
    let (chosen, _) = chosen(role, section, moved)?;
    let law = chosen.description();
    let mut text = format!("\n# The {role} law: {}.\n[{name}]\n", law.summary);
    for (key, _) in chosen.identity() {
        text += &format!("{key} = {}\n", section[key]);
    }
    for setting in law.settings {
        let value = &section[setting.name];
        let unit = match setting.unit {
            "" => String::new(),
            unit => format!(" [{unit}]"),
        };
        text += &format!("{} = {value} # {}{unit}\n", setting.name, setting.meaning);
    }
    Ok(text)
}
