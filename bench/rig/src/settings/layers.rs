//! Merges the layers of the settings (defaults, preset, file, flags) and checks the file. A flag that names another
//! airframe, preset or law than the file is refused if the file has whole sections for the old one: single keys override
//! on purpose, but whole sections come from printed or recorded settings and would fly one airframe with the mass, rotors
//! and gains of another (docs/airframes.md).

use std::fmt::Display;
use std::path::Path;
use std::sync::LazyLock;

use control_api::law::Rig;
use messages::role::Role;
use toml::{Table, Value};

use crate::settings::airframe::{self, Design, PAPER};
use crate::settings::law_settings::{Chosen, Moved};
use crate::settings::toml_access::{beside, coerce, example, kind, nearest, section, text_of};
use crate::settings::{DEFAULT, LAWS, Overrides, Settings, law_settings};
use errors::Failure;

impl Settings {
    /// As [`Self::of`], of sections that stand in a file, beside which relative names of laws are.
    pub fn of_file(given: Table, file: &Path) -> Result<Self, Failure> {
        Self::over(&LAWS, given, Some(file), &Overrides::new())
    }
}

/// The commented default as a table: read once, since a campaign resolves settings for each of its flights.
fn default() -> Result<&'static Table, Failure> {
    static READ: LazyLock<Result<Table, String>> =
        LazyLock::new(|| DEFAULT.parse().map_err(|e| format!("{e}")));
    READ.as_ref()
        .map_err(|e| Failure::failed(format!("the default is broken: {e}")))
}

/// The same with the paper's airframe laid over it, and that airframe.
fn with_paper() -> Result<&'static (Table, Design), Failure> {
    static LAID: LazyLock<Result<(Table, Design), String>> = LazyLock::new(|| {
        let mut table = default().map_err(|e| e.to_string())?.clone();
        let design =
            airframe::design(PAPER, &section(&table, "model")).map_err(|e| e.to_string())?;
        design.lay(&mut table);
        Ok((table, design))
    });
    LAID.as_ref().map_err(|e| Failure::failed(e.clone()))
}

/// The settings as a table: what is given, over the defaults and below what flags set. The file is where it was read.
pub(super) fn layered(
    mut given: Table,
    file: Option<&Path>,
    overrides: &Overrides,
) -> Result<Table, Failure> {
    let place = file
        .map(|path| format!(" (settings file {})", path.display()))
        .unwrap_or_default();
    let flag = |key: &str| {
        overrides
            .iter()
            .find(|(k, _)| *k == key)
            .map(|(_, value)| value)
    };
    let said = |section: &str, key: &str| {
        flag(&format!("{section}.{key}")).or_else(|| given.get(section)?.get(key))
    };
    let mut table = with_paper()?.0.clone();
    let preset = said("flight", "preset")
        .and_then(Value::as_str)
        .unwrap_or(law_settings::DEFAULT_PRESET)
        .to_owned();
    let mut presets = vec![law_settings::DEFAULT_PRESET];
    let mut chosen = Vec::new();
    for (section, role) in law_settings::SECTIONS {
        let law = match flag(&format!("{section}.{}", law_settings::LAW)) {
            Some(name) => law_settings::named(role, Some(name), &Moved::new()),
            None => law_settings::named(
                role,
                said(section, law_settings::LAW)
                    .map(|name| beside(file, name))
                    .as_ref(),
                &Moved::new(),
            )
            .map_err(|failure| failure.append(&place)),
        }?;
        let of_law = law.description().presets.iter().map(|preset| preset.name);
        presets.extend(
            of_law
                .filter(|name| !presets.contains(name))
                .collect::<Vec<_>>(),
        );
        table.insert(
            section.into(),
            Value::Table(law_settings::section(law, &preset, &Rig::default())),
        );
        chosen.push((section, law));
    }
    if !presets.contains(&preset.as_str()) {
        return Err(Failure::usage(format!(
            "flight.preset: unknown preset `{preset}` of the chosen laws [possible values: {}]{place}",
            presets.join(", ")
        ))
        .help("see `ironbird fly --print-config`"));
    }
    for (section, law) in chosen
        .iter()
        .filter(|(section, _)| flag(&format!("{section}.{}", law_settings::LAW)).is_some())
    {
        check_law(file, &mut given, section, *law)?;
    }
    given = checked(file, given, &table)?;
    check_airframe(
        file,
        &given,
        &table,
        flag("flight.airframe").and_then(Value::as_str),
    )?;
    check_preset(
        file,
        &given,
        &table,
        flag("flight.preset").and_then(Value::as_str),
    )?;
    let Design {
        airframe, rotor, ..
    } = lay_airframe(
        &mut table,
        &mut given,
        flag("flight.airframe").and_then(Value::as_str),
        &place,
    )?;
    forget_sums(
        &mut given,
        flag("flight.trajectory").and_then(Value::as_str),
    );
    let rig = Rig {
        airframe,
        rotor,
        ..Rig::default()
    };
    for (section, law) in &chosen {
        table.insert(
            (*section).into(),
            Value::Table(law_settings::section(*law, &preset, &rig)),
        );
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
        law_settings::identify(&mut table, section, law);
    }
    Ok(table)
}

/// Lays the airframe over the defaults: that of the flag, or that of the settings file, or the paper's.
///
/// A section `[airframe]` of the file goes before the name in it: where it is whole, as in the settings of a flight, no
/// other file is read. A flag goes before both.
fn lay_airframe(
    table: &mut Table,
    given: &mut Table,
    flag: Option<&str>,
    place: &str,
) -> Result<Design, Failure> {
    let kept = given
        .remove("airframe")
        .and_then(|kept| kept.as_table().cloned())
        .filter(|_| flag.is_none());
    let named = given
        .get("flight")
        .and_then(|flight| flight.get("airframe"))
        .and_then(Value::as_str);
    let mut values = section(table, "airframe");
    let is_whole = kept.as_ref().is_some_and(|kept| kept.len() == values.len());
    let name = flag
        .or(named)
        .filter(|_| !is_whole)
        .unwrap_or(PAPER)
        .to_owned();
    let mut design = match name.as_str() {
        PAPER => with_paper()?.1.clone(),
        name => airframe::design(name, &section(table, "model"))?,
    };
    if is_whole {
        let rotor = section(given, "rotor");
        if !["min_rad_s", "max_rad_s"]
            .iter()
            .all(|key| rotor.contains_key(*key))
        {
            return Err(Failure::usage(format!(
                "a whole section [airframe] has its own rotors{place}"
            ))
            .help("write them beside it: [rotor] with min_rad_s and max_rad_s"));
        }
        design.sha256 = kept_sum(given);
    } else {
        check_sum(given, flag, &name, &design.sha256)?;
    }
    if let Some(kept) = kept {
        design.lay(table);
        values = section(table, "airframe");
        values.extend(kept);
        let values = values
            .into_iter()
            .filter_map(|(name, value)| Some((name, value.as_float()?)))
            .collect();
        design.airframe = airframe::built(&values)
            .map_err(|e| Failure::usage(format!("airframe: {e}")).help("see `ironbird params`"))?;
    }
    design.lay(table);
    Ok(design)
}

/// What is wrong with the settings that are given, and where.
fn here(file: Option<&Path>, what: impl Display) -> Failure {
    let place = file.map_or_else(
        || "settings".into(),
        |path| format!("settings file {}", path.display()),
    );
    Failure::usage(format!("{place}: {what}")).help("see `ironbird fly --print-config`")
}

pub(super) fn read(path: &Path) -> Result<Table, Failure> {
    let text = text_of(path).map_err(|e| {
        Failure::usage(format!(
            "cannot read the settings file {}: {e}",
            path.display()
        ))
        .help(
            "name a file that you can read; `ironbird fly --print-config` writes one to begin with",
        )
    })?;
    text.parse().map_err(|e: toml::de::Error| {
        match e.span().filter(|_| e.message().contains("integer `")) {
            Some(span) => here(
                Some(path),
                format!("line {}: {BEYOND}", airframe::line_of(&text, &span)),
            ),
            None => here(Some(path), e),
        }
    })
}

const BEYOND: &str = "a whole number beyond 9223372036854775807 cannot be read";

/// What is given: every key must be known, and of the type that the default has.
fn checked(file: Option<&Path>, mut given: Table, default: &Table) -> Result<Table, Failure> {
    let here = |what: String| here(file, what);
    for (section, keys) in &mut given {
        if let Some(moved) = keys
            .as_table()
            .and_then(|keys| law_settings::moved(section, keys))
        {
            return Err(here(moved));
        }
        let known = default.get(section).and_then(Value::as_table);
        let Some(known) = known else {
            return Err(here(format!(
                "unknown section [{section}]{}",
                nearest(section, default.keys())
            )));
        };
        let Some(keys) = keys.as_table_mut() else {
            return Err(here(format!("`{section}` must be a section: [{section}]")));
        };
        for (key, value) in keys {
            let Some(expected) = known.get(key) else {
                let of = known
                    .get(law_settings::LAW)
                    .map(|law| format!(" of the law {law}"))
                    .unwrap_or_default();
                return Err(here(format!(
                    "unknown key `{section}.{key}`{of}{}",
                    nearest(key, known.keys())
                )));
            };
            *value = coerce(value, expected).ok_or_else(|| {
                here(format!(
                    "{section}.{key} = {value}: expected {}, as in {}",
                    kind(expected),
                    example(expected)
                ))
            })?;
        }
    }
    Ok(given)
}

/// What is said beside the settings: of the type that the default has.
pub(super) fn typed(overrides: &Overrides) -> Result<Overrides, Failure> {
    let default = default()?;
    let typed = |(key, value): &(&'static str, Value)| {
        let known = key
            .split_once('.')
            .and_then(|(section, key)| default.get(section)?.get(key));
        // A law's name is looked at where the law is found.
        let Some(expected) = known else {
            return Ok((*key, value.clone()));
        };
        coerce(value, expected)
            .map(|value| (*key, value))
            .ok_or_else(|| {
                here(
                    None,
                    format!(
                        "{key} = {value}: expected {}, as in {}",
                        kind(expected),
                        example(expected)
                    ),
                )
            })
    };
    overrides.iter().map(typed).collect()
}

/// Sections that say of themselves which airframe they were made for, where they are whole.
const OF_ONE_AIRFRAME: [&str; 3] = ["airframe", "plant", "model"];
/// Sections that go before what the flag names.
const KEPT: [&str; 6] = ["plant", "model", "rotor", "outer", "inner", "mixer"];
/// Key of `[flight]` with the SHA-256 of the airframe's file.
const SUM: &str = "airframe_sha256";

/// Refuses whole sections of a settings file beside a flag that names another airframe than the file.
pub(super) fn check_airframe(
    file: Option<&Path>,
    given: &Table,
    default: &Table,
    flag: Option<&str>,
) -> Result<(), Failure> {
    let named = text(given, "flight", "airframe").unwrap_or(PAPER);
    let Some(flag) = flag.filter(|flag| *flag != named) else {
        return Ok(());
    };
    let kept: Vec<&str> = KEPT
        .into_iter()
        .filter(|section| is_whole(given, default, section))
        .collect();
    if kept.is_empty()
        || !OF_ONE_AIRFRAME
            .iter()
            .any(|section| is_whole(given, default, section))
    {
        return Ok(());
    }
    Err(mixed(file, &kept, ("airframe", named), ("airframe", flag)))
}

/// Refuses whole sections of laws in a settings file beside a flag that names another preset than the file.
pub(super) fn check_preset(
    file: Option<&Path>,
    given: &Table,
    default: &Table,
    flag: Option<&str>,
) -> Result<(), Failure> {
    let named = text(given, "flight", "preset").unwrap_or(law_settings::DEFAULT_PRESET);
    let Some(flag) = flag.filter(|flag| *flag != named) else {
        return Ok(());
    };
    let has_settings = |section: &&str| {
        table(given, section).is_some_and(|keys| keys.keys().any(|key| is_laws(key)))
    };
    let of_laws = law_settings::SECTIONS
        .into_iter()
        .map(|(section, _)| section);
    let kept: Vec<&str> = of_laws
        .filter(|section| is_whole(given, default, section))
        .filter(has_settings)
        .collect();
    if kept.is_empty() {
        return Ok(());
    }
    Err(mixed(file, &kept, ("preset", named), ("preset", flag)))
}

/// Refuses the settings of a law that a settings file names beside a flag that names another one. Where the file has
/// none but the law's name, its sum is forgotten with it.
pub(super) fn check_law(
    file: Option<&Path>,
    given: &mut Table,
    section: &str,
    flag: Chosen,
) -> Result<(), Failure> {
    let Some(keys) = given.get_mut(section).and_then(Value::as_table_mut) else {
        return Ok(());
    };
    let Some(named) = keys.get(law_settings::LAW).map(|law| beside(file, law)) else {
        return Ok(());
    };
    let Some(named) = named.as_str().filter(|named| !flag.is_named(named)) else {
        return Ok(());
    };
    if keys.keys().any(|key| is_laws(key)) {
        return Err(mixed(
            file,
            &[section],
            ("law", named),
            (section, &flag.named()),
        ));
    }
    keys.remove(law_settings::SHA256);
    Ok(())
}

/// Whether a key of a law's section is the law's own.
fn is_laws(key: &str) -> bool {
    ![law_settings::LAW, law_settings::SHA256].contains(&key)
}

/// Whether a section has every key that it can have.
fn is_whole(given: &Table, default: &Table, section: &str) -> bool {
    let (Some(given), Some(known)) = (table(given, section), table(default, section)) else {
        return false;
    };
    known
        .keys()
        .all(|key| key == law_settings::LAW || given.contains_key(key))
}

/// Says which sections are whose, and what the flag names instead; beside sections that are in no file, the argument.
fn mixed(
    file: Option<&Path>,
    sections: &[&str],
    (kind, named): (&str, &str),
    (key, other): (&str, &str),
) -> Failure {
    let all = sections
        .iter()
        .map(|section| format!("[{section}]"))
        .collect::<Vec<_>>()
        .join(", ");
    let (what, them) = match sections.len() {
        1 => (format!("its section {all} is"), "it"),
        _ => (format!("its whole sections {all} are"), "them"),
    };
    let said = |place: &str, said: &str| {
        Failure::usage(format!(
            "{place}: {what} of the {kind} `{named}`, and would go before those of {said}"
        ))
    };
    let Some(path) = file else {
        return said("settings", &format!("{key}=\"{other}\"")).help(format!(
            "take {them} out of the settings, or fly without {key}=\"{other}\""
        ));
    };
    let flag = format!("--{key} {other}");
    said(&format!("settings file {}", path.display()), &flag).help(format!(
        "take {them} out of the file, or begin with those of this {kind}: ironbird fly {flag} --print-config"
    ))
}

/// Refuses the settings of a law beside a law that the rig does not know, as [`Settings::of`] does beside one it knows.
pub fn check_foreign_law(role: Role, section: &Table, other: &str) -> Result<(), Failure> {
    let Some(named) = section.get(law_settings::LAW).and_then(Value::as_str) else {
        return Ok(());
    };
    match section.keys().any(|key| is_laws(key)) {
        true => Err(mixed(
            None,
            &[role.name()],
            ("law", named),
            (role.name(), other),
        )),
        false => Ok(()),
    }
}

/// The SHA-256 that a settings file has of its airframe's file; empty where it has none.
pub(super) fn kept_sum(given: &Table) -> String {
    text(given, "flight", SUM).unwrap_or_default().to_owned()
}

/// Refuses an airframe file that is no longer the one that the settings were made for. A flag may name another.
pub(super) fn check_sum(
    given: &Table,
    flag: Option<&str>,
    name: &str,
    sha256: &str,
) -> Result<(), Failure> {
    let wanted = kept_sum(given);
    let is_another = flag.is_some_and(|flag| text(given, "flight", "airframe") != Some(flag));
    if is_another || wanted.is_empty() || wanted == sha256 {
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

/// Takes the sums out of a file's settings that belong to another airframe or trajectory than what is flown.
pub(super) fn forget_sums(given: &mut Table, trajectory: Option<&str>) {
    let is_another =
        trajectory.is_some_and(|flag| text(given, "flight", "trajectory") != Some(flag));
    let mut forget = |section: &str, key: &str| {
        given
            .get_mut(section)
            .and_then(Value::as_table_mut)
            .and_then(|section| section.remove(key));
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
