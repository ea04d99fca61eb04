//! Merges the layers of the settings (defaults, preset, file, flags) and checks the file. A flag that names another
//! airframe, preset or law than the file is refused if the file has whole sections for the old one: single keys override
//! on purpose, but whole sections come from printed or recorded settings and would fly one airframe with the mass, rotors
//! and gains of another (docs/airframes.md).

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::LazyLock;

use control_api::description::Description;
use control_api::law::Rig;
use messages::limits::RotorLimits;
use messages::role::{Channel, Role};
use messages::telemetry::LAW_ROLES;
use toml::{Table, Value};

use crate::airframe::{self, Design, OWN, PAPER};
use crate::law_settings::{self, Chosen, DEFAULT_PRESET, LAW, Moved, SHA256, presets_of};
use crate::overrides::{self, Overrides, PRESET};
use crate::toml_access::{
    DEFAULT_TABLE, coerce, example, kind, nearest, place_path, place_paths, table, text, text_of,
};
use errors::{Failure, toml_mistake};

/// The default with the paper's airframe laid over it, and that airframe. Read once, since a campaign resolves settings for
/// each of its flights.
pub(super) fn with_paper() -> Result<&'static (Table, Design), Failure> {
    static LAID: LazyLock<Result<(Table, Design), String>> = LazyLock::new(|| {
        let mut table = DEFAULT_TABLE.clone();
        let design = airframe::design(PAPER).map_err(|e| e.to_string())?;
        design.lay(&mut table);
        Ok((table, design))
    });
    LAID.as_ref().map_err(|e| Failure::failed(e.clone()))
}

/// The settings as a table: what is given, over the defaults and below what flags set. The file is where it was read.
pub(super) fn layered(
    given: Table,
    file: Option<&Path>,
    overrides: &Overrides,
) -> Result<Table, Failure> {
    let (mut given, mut overrides) = (given, overrides.clone());
    let typed = overrides
        .iter()
        .filter(|it| overrides::parts(it.0).0.is_some());
    overrides::check_twice(typed.map(|(flag, value)| (*flag, value)))?;
    let folder = file.and_then(Path::parent).unwrap_or(Path::new(""));
    place_paths(&mut given, folder)?;
    for (flag, value) in &mut overrides {
        let (_, key) = overrides::parts(flag)
            .1
            .rsplit_once('.')
            .unwrap_or_default();
        place_path(key, value, Path::new(""))?;
    }
    Layers {
        given,
        file,
        overrides,
    }
    .merge()
}

struct Layers<'a> {
    given: Table,
    file: Option<&'a Path>,
    overrides: Overrides,
}

/// The section with the laws of single channels.
const CHANNEL: &str = "channel";
type ChannelLaws = BTreeMap<(Channel, Role), Table>;
/// Sections that say of themselves which airframe they were made for, if they are whole.
const OF_ONE_AIRFRAME: [&str; 3] = ["airframe", "plant", "model"];
/// Sections that override what the airframe flag names.
const KEPT: [&str; 6] = ["plant", "model", "rotor", "outer", "inner", "mixer"];
/// Key of `[flight]` with the SHA-256 of the airframe's file.
const SUM: &str = "airframe_sha256";

impl Layers<'_> {
    fn flag(&self, section: &str, key: &str) -> Option<&Value> {
        let is_it = |flag| overrides::parts(flag).1.split_once('.') == Some((section, key));
        let flag = self.overrides.iter().rev().find(|(flag, _)| is_it(flag));
        flag.map(|(_, value)| value)
    }

    fn flag_text(&self, key: &str) -> Option<&str> {
        self.flag("flight", key).and_then(Value::as_str)
    }

    fn given_text(&self, key: &str) -> Option<&str> {
        text(&self.given, "flight", key)
    }

    /// A rotor limit that overrides the airframe's.
    fn rotor_limit(&self, key: &str) -> Option<f64> {
        let given = || table(&self.given, "rotor")?.get(key);
        self.flag("rotor", key).or_else(given)?.as_float()
    }

    /// The file, as the end of an error.
    fn place(&self) -> String {
        let origin = |_| format!(" ({})", origin(self.file));
        self.file.map(origin).unwrap_or_default()
    }

    fn merge(mut self) -> Result<Table, Failure> {
        let mut table = with_paper()?.0.clone();
        let preset = self.flag_text("preset").or(self.given_text("preset"));
        let preset = preset.unwrap_or(DEFAULT_PRESET).to_owned();
        let laws = self.laws()?;
        let presets = laws
            .iter()
            .map(|(section, law)| self.preset_of(section, law.description(), &preset))
            .collect::<Result<Vec<_>, _>>()?;
        let insert_laws = |table: &mut Table, rig: &Rig| {
            for ((section, law), preset) in laws.iter().zip(&presets) {
                let keys = law_settings::section(*law, preset, rig);
                table.insert((*section).into(), Value::Table(keys));
            }
        };
        insert_laws(&mut table, &Rig::default());
        self.check_preset_name(&preset, &laws)?;
        let place = origin(self.file);
        let of_channels = self.take_channel_laws(&place)?;
        for (section, law) in &laws {
            if self.flag(section, LAW).is_some() {
                self.check_law(section, *law)?;
            }
        }
        check_keys(&mut self.given, &place, &table)?;
        self.check_overrides(&table)?;
        self.check_whole_sections(&table)?;
        let Design {
            airframe, rotor, ..
        } = self.lay_airframe(&mut table)?;
        self.forget_sums();
        let limit = |key, own| self.rotor_limit(key).unwrap_or(own);
        let rig = Rig {
            airframe,
            rotor: RotorLimits {
                min_rad_s: limit("min_rad_s", rotor.min_rad_s),
                max_rad_s: limit("max_rad_s", rotor.max_rad_s),
            },
            ..Rig::default()
        };
        insert_laws(&mut table, &rig);
        self.overlay(&mut table);
        for (section, law) in laws {
            law_settings::identify(&mut table, section, law);
        }
        let channels = channel_sections(of_channels, &preset, &rig)?;
        if !channels.is_empty() {
            table.insert(CHANNEL.into(), Value::Table(channels));
        }
        Ok(table)
    }

    /// Lays the keys of the file over the table, and those of the flags over them.
    fn overlay(self, table: &mut Table) {
        for (section, keys) in self.given {
            if let (Some(Value::Table(into)), Value::Table(keys)) = (table.get_mut(&section), keys)
            {
                into.extend(keys);
            }
        }
        for (flag, value) in self.overrides {
            if let Some((section, key)) = overrides::parts(flag).1.split_once('.')
                && let Some(Value::Table(into)) = table.get_mut(section)
                && !is_own_preset(section, key)
            {
                into.insert(key.into(), value);
            }
        }
    }

    /// The laws of single channels: those of the file's sections, as [channel.b.inner], and those of flags, as `b:inner=pid`.
    fn take_channel_laws(&mut self, place: &str) -> Result<ChannelLaws, Failure> {
        let mut laws = ChannelLaws::new();
        let named = |channel: &str, role: &str| {
            let channel = Channel::ALL.into_iter().find(|it| it.name() == channel);
            let channel = channel.filter(|it| *it != Channel::A);
            channel.zip(LAW_ROLES.into_iter().find(|it| it.name() == role))
        };
        let unknown = |place: &str, channel: &str, role: &str| {
            here(
                place,
                format!(
                    "unknown section [{CHANNEL}.{channel}.{role}]: channels b and c have [{CHANNEL}.b.inner] and the like"
                ),
            )
        };
        let given = self.given.remove(CHANNEL);
        let channels = given.as_ref().and_then(Value::as_table);
        for (channel, roles) in channels.into_iter().flatten() {
            let what =
                format!("`{CHANNEL}.{channel}` must be a section: [{CHANNEL}.{channel}.inner]");
            for (role, keys) in roles.as_table().ok_or_else(|| here(place, what))? {
                let law = named(channel, role).zip(keys.as_table());
                let (of, keys) = law.ok_or_else(|| unknown(place, channel, role))?;
                laws.insert(of, keys.clone());
            }
        }
        let flags = self.flag(CHANNEL, "laws").and_then(Value::as_array);
        let flags = flags.into_iter().flatten().filter_map(Value::as_str);
        let pairs = flags.clone().filter_map(|text| text.split_once('='));
        overrides::check_twice(pairs.map(|(of, law)| (format!("--channel {of}"), law)))?;
        for text in flags {
            let law = || {
                let (of, law) = text.split_once('=').filter(|(_, law)| !law.is_empty())?;
                let (channel, role) = of.split_once(':')?;
                Some((named(channel, role)?, law))
            };
            let (of, law) = law().ok_or_else(|| {
                Failure::usage(format!("--channel {text}: write LETTER:ROLE=LAW, with b or c, and outer, inner or mixer"))
                    .help("for example --channel b:inner=pid")
            })?;
            laws.insert(of, Table::from_iter([(LAW.to_owned(), Value::from(law))]));
        }
        for (flag, value) in std::mem::take(&mut self.overrides) {
            let parts: Vec<&str> = overrides::parts(flag).1.splitn(4, '.').collect();
            let [CHANNEL, channel, role, key] = parts[..] else {
                self.overrides.push((flag, value));
                continue;
            };
            let of = named(channel, role).ok_or_else(|| unknown("--set", channel, role))?;
            laws.entry(of).or_default().insert(key.into(), value);
        }
        Ok(laws)
    }

    /// The laws that the flags or the file name, each with its section.
    fn laws(&self) -> Result<Vec<(&'static str, Chosen)>, Failure> {
        let law = |role: Role| {
            let section = role.name();
            let law = match self.flag(section, LAW) {
                Some(name) => law_settings::named(role, Some(name), &Moved::new()),
                None => {
                    let name = self.given.get(section).and_then(|keys| keys.get(LAW));
                    law_settings::named(role, name, &Moved::new())
                        .map_err(|failure| failure.append(&self.place()))
                }
            };
            Ok((section, law?))
        };
        LAW_ROLES.into_iter().map(law).collect()
    }

    fn check_preset_name(&self, preset: &str, laws: &[(&str, Chosen)]) -> Result<(), Failure> {
        let known = presets_of(laws.iter().map(|(_, law)| law.description()));
        if known.contains(&preset) {
            return Ok(());
        }
        Err(Failure::usage(format!(
            "flight.preset: unknown preset `{preset}` of the chosen laws [possible values: {}]{}",
            known.join(", "),
            self.place()
        ))
        .help("see `ironbird fly --print-config`"))
    }

    /// The preset of a law: its own, which it must have, or else that of the flight.
    fn preset_of(
        &self,
        section: &str,
        law: &Description,
        of_flight: &str,
    ) -> Result<String, Failure> {
        let Some(own) = self.flag(section, PRESET) else {
            return Ok(of_flight.to_owned());
        };
        let known = presets_of([law]);
        match own.as_str().filter(|own| known.contains(own)) {
            Some(own) => Ok(own.to_owned()),
            None => Err(Failure::usage(format!(
                "{section}.{PRESET} = {own}: the law `{}` has no such preset [possible values: {}]",
                law.name,
                known.join(", ")
            ))
            .help(format!("see `ironbird laws {}`", law.name))),
        }
    }

    /// Keys that the user typed must be known, and of the type that the default has.
    fn check_overrides(&mut self, default: &Table) -> Result<(), Failure> {
        for (flag, value) in &mut self.overrides {
            let (Some(flag), key) = overrides::parts(flag) else {
                continue;
            };
            let (section, key) = key.split_once('.').unwrap_or((key, ""));
            if section == "airframe" {
                return Err(here(flag, format!("{section}.{key} cannot be set")).help(
                    "write an airframe file: --airframe FILE.toml (`ironbird docs airframes`)",
                ));
            }
            if is_own_preset(section, key) {
                continue;
            }
            let keys = Table::from_iter([(key.to_owned(), value.clone())]);
            let mut one = Table::from_iter([(section.to_owned(), Value::Table(keys))]);
            check_keys(&mut one, flag, default)?;
            *value = one[section][key].clone();
        }
        Ok(())
    }

    /// Refuses whole sections of the file beside a flag that names another airframe or preset than the file.
    fn check_whole_sections(&self, default: &Table) -> Result<(), Failure> {
        // Whether a section has every key that it can have.
        let is_whole = |section: &&str| {
            let given = table(&self.given, section).zip(table(default, section));
            given.is_some_and(|(given, known)| {
                known
                    .keys()
                    .all(|key| key == LAW || given.contains_key(key))
            })
        };
        let has_settings = |section: &&str| {
            table(&self.given, section).is_some_and(|keys| keys.keys().any(|key| is_laws(key)))
        };
        let mut of_airframe: Vec<&str> = KEPT.into_iter().filter(is_whole).collect();
        if !OF_ONE_AIRFRAME.iter().any(&is_whole) {
            of_airframe.clear();
        }
        let airframe = if is_whole(&"airframe") { OWN } else { PAPER };
        let laws = LAW_ROLES.into_iter().map(Role::name);
        let of_preset = laws.filter(is_whole).filter(has_settings).collect();
        for (kind, default, sections) in [
            ("airframe", airframe, of_airframe),
            ("preset", DEFAULT_PRESET, of_preset),
        ] {
            let named = self.given_text(kind).unwrap_or(default);
            if let Some(flag) = self.flag_text(kind).filter(|flag| *flag != named)
                && !sections.is_empty()
            {
                return Err(mixed(self.file, &sections, (kind, named), (kind, flag)));
            }
        }
        Ok(())
    }

    /// Refuses the settings of a law in the file beside a flag that names another one. If the file has only the law's
    /// name, its sum is forgotten with it.
    fn check_law(&mut self, section: &str, flag: Chosen) -> Result<(), Failure> {
        let Some(Value::Table(keys)) = self.given.get_mut(section) else {
            return Ok(());
        };
        let named = keys.get(LAW).and_then(Value::as_str).map(str::to_owned);
        let Some(named) = named.filter(|named| !flag.is_named(named)) else {
            return Ok(());
        };
        if keys.keys().any(|key| is_laws(key)) {
            let other = flag.named();
            return Err(mixed(
                self.file,
                &[section],
                ("law", &named),
                (section, &other),
            ));
        }
        keys.remove(SHA256);
        Ok(())
    }

    /// Lays the airframe over the defaults: that of the flag, or that of the settings file, or the paper's.
    ///
    /// A section `[airframe]` of the file overrides the name in it: if it is whole, as in the settings of a flight, no
    /// other file is read. A flag overrides both, and cannot be combined with a part of a section.
    fn lay_airframe(&mut self, settings: &mut Table) -> Result<Design, Failure> {
        let flag = self.flag_text("airframe").map(str::to_owned);
        let kept = match self.given.remove("airframe") {
            Some(Value::Table(kept)) => Some(kept),
            _ => None,
        };
        let keys = table(settings, "airframe").map_or(0, Table::len);
        if let (Some(named), Some(kept)) = (&flag, &kept)
            && kept.len() != keys
        {
            let place = self.place();
            return Err(Failure::usage(format!(
                "--airframe {named} and a section [airframe]{place}: only one of them can say what is flown"
            ))
            .help("write the values into a copy of the airframe's file, or change the plant alone ([plant])"));
        }
        let kept = kept.filter(|_| flag.is_none());
        let is_whole = kept.as_ref().is_some_and(|kept| kept.len() == keys);
        let name = flag.as_deref().or(self.given_text("airframe"));
        let name = name.filter(|_| !is_whole).unwrap_or(PAPER);
        let mut design = match name {
            PAPER => with_paper()?.1.clone(),
            name => airframe::design(name)?,
        };
        let sum = self.flag_text(SUM);
        let wanted = sum.or(self.given_text(SUM)).unwrap_or_default();
        if is_whole {
            let has = |key| self.rotor_limit(key).is_some();
            if !has("min_rad_s") || !has("max_rad_s") {
                return Err(Failure::usage(format!(
                    "a whole section [airframe] has its own rotors{}",
                    self.place()
                ))
                .help("write them beside it: [rotor] with min_rad_s and max_rad_s"));
            }
            design.sha256 = wanted.to_owned();
            if self.given_text("airframe").is_none()
                && let Some(Value::Table(flight)) = settings.get_mut("flight")
            {
                flight.insert("airframe".into(), Value::String(OWN.into()));
            }
        } else if sum.is_some() || flag.is_none() || flag.as_deref() == self.given_text("airframe")
        {
            check_sum(wanted, name, &design.sha256)?;
        }
        design.lay(settings);
        if let Some(kept) = kept {
            let mut values = table(settings, "airframe").cloned().unwrap_or_default();
            values.extend(kept);
            let number = |(name, value): (String, Value)| Some((name, value.as_float()?));
            let values = values.into_iter().filter_map(number).collect();
            design.airframe = airframe::built(&values).map_err(|e| {
                Failure::usage(format!("airframe: {e}")).help("see `ironbird params`")
            })?;
            design.lay(settings);
        }
        Ok(design)
    }

    /// Takes the sums out of the file's settings that belong to another airframe or trajectory than what is flown.
    fn forget_sums(&mut self) {
        let flag = self.flag_text("trajectory");
        let given = self.given_text("trajectory");
        let is_another = given.is_some() && flag.is_some() && flag != given;
        let mut forget = |section: &str, key: &str| {
            if let Some(Value::Table(keys)) = self.given.get_mut(section) {
                keys.remove(key);
            }
        };
        // That of the airframe's file is known from the file itself.
        forget("flight", SUM);
        if is_another {
            forget("trajectory", "sha256");
        }
    }
}

/// The sections of the laws of single channels.
fn channel_sections(of_channels: ChannelLaws, preset: &str, rig: &Rig) -> Result<Table, Failure> {
    let mut channels = Table::new();
    for ((channel, role), mut given) in of_channels {
        let law = law_settings::named(role, given.get(LAW), &Moved::new())
            .map_err(|failure| failure.append(&format!(" (channel {channel})")))?;
        let mut section = law_settings::section(law, preset, rig);
        let place = format!("channel {channel}");
        check_section(role.name(), &mut given, &section, &place)?;
        section.extend(given);
        let own = channels
            .entry(channel.name())
            .or_insert(Value::Table(Table::new()));
        if let Value::Table(own) = own {
            own.insert(role.name().into(), Value::Table(section));
            law_settings::identify(own, role.name(), law);
        }
    }
    Ok(channels)
}

/// Every key that is given at a place must be known, and of the type that the default has.
fn check_keys(given: &mut Table, place: &str, default: &Table) -> Result<(), Failure> {
    let here = |what: String| here(place, what);
    for (section, keys) in given {
        let Some(known) = table(default, section) else {
            let like = nearest(section, default.keys());
            return Err(here(format!("unknown section [{section}]{like}")));
        };
        let Some(keys) = keys.as_table_mut() else {
            return Err(here(format!("`{section}` must be a section: [{section}]")));
        };
        check_section(section, keys, known, place)?;
    }
    Ok(())
}

/// The same for the keys of a section.
fn check_section(
    section: &str,
    keys: &mut Table,
    known: &Table,
    place: &str,
) -> Result<(), Failure> {
    let here = |what: String| here(place, what);
    for (key, value) in keys {
        let Some(expected) = known.get(key) else {
            let near = nearest(key, known.keys());
            let Some(law) = known.get(LAW).and_then(Value::as_str) else {
                return Err(here(format!("unknown key `{section}.{key}`{near}")));
            };
            let own = known.keys().filter(|key| is_laws(key)).cloned();
            let own = own.collect::<Vec<_>>().join(", ");
            let unknown = format!("unknown key `{section}.{key}` of the law \"{law}\"{near}");
            return Err(here(unknown).help(format!(
                "its settings are {own}; `ironbird laws {law}` explains them"
            )));
        };
        *value = coerce(value, expected)
            .ok_or_else(|| here(unexpected(&format!("{section}.{key}"), value, expected)))?;
    }
    Ok(())
}

/// Refuses an airframe file that is no longer the one that the settings were made for.
fn check_sum(wanted: &str, name: &str, sha256: &str) -> Result<(), Failure> {
    if wanted.is_empty() || wanted == sha256 {
        return Ok(());
    }
    let found = if sha256.is_empty() {
        "is built in".to_owned()
    } else {
        format!("has the SHA-256 {sha256}")
    };
    Err(Failure::usage(format!(
        "airframe {name} {found}, but the settings were made for a file with {wanted}"
    ))
    .help("bring the old file back, or take flight.airframe_sha256 out of the settings"))
}

/// Where settings come from.
fn origin(file: Option<&Path>) -> String {
    match file {
        Some(path) => format!("settings file {}", path.display()),
        None => "settings".into(),
    }
}

/// What is wrong with the settings that are given, and where.
fn here(place: &str, what: impl Display) -> Failure {
    Failure::usage(format!("{place}: {what}")).help("see `ironbird fly --print-config`")
}

fn unexpected(key: &str, value: &Value, expected: &Value) -> String {
    let (kind, example) = (kind(expected), example(expected));
    format!("{key} = {value}: expected {kind}, as in {example}")
}

pub(super) fn read(path: &Path) -> Result<Table, Failure> {
    let text =
        text_of(path).map_err(|e| {
            Failure::usage(format!("cannot read the settings file {}: {e}", path.display())).help(
            "name a file that you can read; `ironbird fly --print-config` writes one to begin with",
        )
        })?;
    let place = origin(Some(path));
    let unread = |e: toml::de::Error| here(&place, toml_mistake(&text, e.message(), e.span()));
    text.parse().map_err(unread)
}

/// What is set beside the settings: of the type that the default has.
pub(super) fn typed(overrides: &Overrides) -> Result<Overrides, Failure> {
    let typed = |(key, value): &(&'static str, Value)| {
        let known = key
            .split_once('.')
            .and_then(|(section, key)| DEFAULT_TABLE.get(section)?.get(key));
        // A law's name is checked when the law is looked up.
        let Some(expected) = known else {
            return Ok((*key, value.clone()));
        };
        coerce(value, expected)
            .map(|value| (*key, value))
            .ok_or_else(|| here("settings", unexpected(key, value, expected)))
    };
    overrides.iter().map(typed).collect()
}

/// Whether a key selects the preset of one law.
fn is_own_preset(section: &str, key: &str) -> bool {
    key == PRESET && LAW_ROLES.iter().any(|law| law.name() == section)
}

/// Whether a key of a law's section is the law's own.
fn is_laws(key: &str) -> bool {
    ![LAW, SHA256].contains(&key)
}

/// Says which sections are whose, and what the flag names instead; beside sections that are in no file, the argument.
fn mixed(
    file: Option<&Path>,
    sections: &[&str],
    (kind, named): (&str, &str),
    (key, other): (&str, &str),
) -> Failure {
    let all: Vec<String> = sections
        .iter()
        .map(|section| format!("[{section}]"))
        .collect();
    let all = all.join(", ");
    let (what, them) = match sections.len() {
        1 => (format!("its section {all} is"), "it"),
        _ => (format!("its whole sections {all} are"), "them"),
    };
    let place = origin(file);
    let said = |said: &str| {
        Failure::usage(format!(
            "{place}: {what} of the {kind} `{named}`, and would go before those of {said}"
        ))
    };
    if file.is_none() {
        let given = format!("{key}=\"{other}\"");
        let help = format!("take {them} out of the settings, or fly without {given}");
        return said(&given).help(help);
    }
    let flag = format!("--{key} {other}");
    said(&flag).help(format!(
        "take {them} out of the file, or begin with those of this {kind}: ironbird fly {flag} --print-config"
    ))
}

/// Refuses the settings of a law beside a law that the rig does not know, as [`Settings::of`] does beside one it knows.
pub fn check_foreign_law(role: Role, section: &Table, other: &str) -> Result<(), Failure> {
    match section.get(LAW).and_then(Value::as_str) {
        Some(named) if section.keys().any(|key| is_laws(key)) => {
            let name = role.name();
            Err(mixed(None, &[name], ("law", named), (name, other)))
        }
        _ => Ok(()),
    }
}
