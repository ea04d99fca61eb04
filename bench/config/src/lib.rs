//! Settings: defaults, preset, file, flags, in this order; checked before anything starts.
//!
//! Owns the sections and their keys; `declarations` explains how a setting is declared. Start reading in
//! [`Settings::resolve`].

pub mod airframe;
mod airframe_checks;
pub mod declarations;
pub mod law_settings;
mod layers;
pub mod overrides;
pub mod planned_faults;
mod processes;
mod settings;
#[cfg(test)]
mod tests;
mod toml_access;
pub mod trajectory;
mod validation;

use std::path::Path;

use errors::Failure;
use messages::telemetry::LAW_ROLES;
use toml::{Table, Value};

pub use layers::check_foreign_law;
use layers::{layered, read, typed, with_paper};
pub use overrides::Overrides;
pub use processes::check_cpu;
pub use settings::*;
pub use toml_access::{bytes_of, utf8};
pub use trajectory::PointsFile;

impl Settings {
    /// The settings that result from a file and flags. An error names the key, the value, what is allowed, and where it
    /// came from.
    pub fn resolve(file: Option<&Path>, overrides: &Overrides) -> Result<Self, Failure> {
        Self::resolve_asking(true, file, overrides)
    }

    /// The value that a settings file has for a key.
    pub fn in_file(
        file: Option<&Path>,
        section: &str,
        key: &str,
    ) -> Result<Option<Value>, Failure> {
        let given = file.map(read).transpose()?;
        let section = given.as_ref().and_then(|given| given.get(section));
        Ok(section.and_then(|section| section.get(key)).cloned())
    }

    /// As [`Self::resolve`]; a process of a flight need not ask laws of files whether they accept their settings.
    pub fn resolve_asking(
        asks: bool,
        file: Option<&Path>,
        overrides: &Overrides,
    ) -> Result<Self, Failure> {
        let given = file.map(read).transpose()?.unwrap_or_default();
        Self::over(asks, given, file, overrides)
    }

    /// The settings that result from sections of keys, as a file would have them, and from keys that are set beside them.
    pub fn of(given: Table, beside: &Overrides) -> Result<Self, Failure> {
        Self::over(true, given, None, &typed(beside)?)
    }

    /// As [`Self::of`], for the sections of a file; relative paths start at its folder.
    pub fn of_file(given: Table, file: &Path) -> Result<Self, Failure> {
        Self::over(true, given, Some(file), &Overrides::new())
    }

    /// The settings in the text that all roles of a flight share. Keys that it does not have are the defaults.
    pub fn of_shared(text: &str) -> Result<Self, Failure> {
        let unread = |e: toml::de::Error| {
            Failure::failed(format!("the settings of the flight cannot be read: {e}"))
        };
        let mut table = with_paper()?.0.clone();
        let laws = LAW_ROLES.map(|role| (role.name().to_owned(), Value::Table(Table::new())));
        table.extend(laws);
        for (section, keys) in text.parse::<Table>().map_err(unread)? {
            match (table.get_mut(&section), keys) {
                (Some(Value::Table(into)), Value::Table(keys)) => into.extend(keys),
                (_, keys) => drop(table.insert(section, keys)),
            }
        }
        table.try_into().map_err(unread)
    }

    fn over(
        asks: bool,
        given: Table,
        file: Option<&Path>,
        overrides: &Overrides,
    ) -> Result<Self, Failure> {
        let resolved = |overrides: &Overrides| {
            let table = layered(given.clone(), file, overrides)?;
            Self::from_table(table, asks).map_err(|failure| match file {
                Some(path) if !validation::is_of_flags(&failure, overrides) => {
                    failure.append(&format!(" (settings file {})", path.display()))
                }
                _ => failure,
            })
        };
        resolved(overrides).map_err(|failure| validation::blamed(failure, overrides, resolved))
    }
}
