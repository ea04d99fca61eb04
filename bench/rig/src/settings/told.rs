//! What is said of settings that are wrong.

use failure::Failure;
use law::description::Refused;
use model::boards::SETTINGS_MAX;
use model::parameters::shown;
use toml::{Table, Value};

use super::layers::layered;
use super::{Overrides, Settings};

/// The last part of a path, or a name.
pub(crate) fn last_name(path: &str) -> &str {
    path.rsplit_once('/').map_or(path, |(_, file)| file)
}

/// What a law does not take.
pub(super) fn refused(e: Refused) -> Failure {
    Failure::usage(format!("settings: {e}")).help("see `ironbird fly --print-config`")
}

/// Refuses a value that is not from `min` to `max`.
pub(super) fn within(key: &str, value: f64, min: f64, max: f64) -> Result<(), Failure> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    let [value, min, max] = [value, min, max].map(shown);
    Err(Failure::usage(format!("{key} = {value} is out of range: allowed are {min} to {max}"))
        .help("`ironbird fly --print-config` explains every setting"))
}

/// A value that is no setting's; the error names its key in the second line.
pub(super) fn unread(e: &toml::de::Error) -> Failure {
    let what = e.to_string().trim_end().replace('\n', " ");
    // No setting that is a whole number may be negative.
    let what = match (what.strip_prefix("invalid value: integer `"), what.rsplit('`').nth(1)) {
        (Some(rest), Some(key)) if rest.contains("expected u64") => {
            let value = rest.split('`').next().unwrap_or_default();
            format!("{key} = {value} is out of range: allowed are whole numbers from 0 to {}", i64::MAX)
        }
        _ => what,
    };
    Failure::usage(format!("settings: {what}")).help("see `ironbird fly --print-config`")
}

/// Refuses a text that would not come back from a report, or would end its line where settings have one each.
pub(super) fn check_texts(section: &str, table: &Table) -> Result<(), Failure> {
    table.iter().try_for_each(|(key, value)| match value {
        Value::Table(keys) => check_texts(&format!("{key}."), keys),
        Value::String(text) if text.contains(char::is_control) => Err(Failure::usage(format!(
            "settings: {section}{key} = \"{}\": expected a text without control characters",
            text.escape_default()
        ))
        .help("give the file a name without them")),
        _ => Ok(()),
    })
}

/// Whether flags fail in the same way without a settings file, so that it has no part in it.
pub(super) fn is_of_flags(failure: &Failure, overrides: &Overrides) -> bool {
    let alone = layered(Table::new(), None, overrides).and_then(|table| Settings::taken(table, &[]));
    alone.is_err_and(|alone| alone.to_string() == failure.to_string())
}

impl Settings {
    /// Refuses settings that do not fit on the board that the processes of a flight share them by.
    ///
    /// # Errors
    /// A usage [`Failure`] says what takes the room.
    pub(super) fn check_length(&self) -> Result<(), Failure> {
        let length = self.shared_text()?.len();
        if length <= SETTINGS_MAX {
            return Ok(());
        }
        let faults: usize = self.flight.faults.iter().map(String::len).sum();
        Err(Failure::usage(format!(
            "the settings that the processes share are {length} bytes long: allowed are {SETTINGS_MAX}, and \
             flight.faults takes {faults} of them"
        ))
        .help(
            "put values that change at the same instant into one fault, write numbers of fewer digits, or plan fewer \
             and inject the rest in flight",
        ))
    }
}
