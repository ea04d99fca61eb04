//! Makes settings from the merged table, and checks them: ranges, gates, laws, faults, start and length.

use analysis::theorem::no_theorem;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Display;

use control_api::Rig;
use control_api::description::Refused;
use errors::Failure;
use messages::blackboards::SETTINGS_MAX;
use messages::parameters::shown;
use messages::telemetry::LAW_ROLES;
use plant::Plant;
use toml::{Table, Value};

use super::airframe_checks::impossible_body;
use super::declarations::{self, Allowed, Setting};
use super::layers::layered;
use super::overrides::{self, Overrides};
use super::settings::Settings;

/// Longest flight [s]: 30 days. At 1 kHz, MCAP's sequence numbers of 32 bits would start over after 49.
const LONGEST_S: f64 = 30.0 * 86_400.0;

fn number(value: &Value) -> Option<f64> {
    value.as_float().or(value.as_integer().map(|it| it as f64))
}

fn check_allowed(table: &Table) -> Result<(), Failure> {
    let values = |path: &str| {
        let (section, key) = path.split_once('.')?;
        table.get(section)?.get(key)
    };
    for setting in declarations::settings() {
        let Some(value) = values(setting.path) else {
            continue;
        };
        match setting.allowed {
            Allowed::Range(min, max) => check_range(setting, value, min, max)?,
            Allowed::Counts(counts) => {
                let counted = value.as_integer().is_none_or(|it| counts.contains(&it));
                if !counted {
                    return Err(outside(setting, value));
                }
            }
            Allowed::Limit => check_limit(setting, number(value), f64::MAX)?,
            Allowed::Share => check_limit(setting, number(value), 100.0)?,
            Allowed::Any | Allowed::OneOf(_) => {}
        }
    }
    Ok(())
}

fn check_range(setting: &Setting, value: &Value, min: f64, max: f64) -> Result<(), Failure> {
    if let Some(value) = number(value) {
        within(setting.path, value, min, max)?;
    }
    let values = value.as_array().into_iter().flatten().filter_map(number);
    for (i, value) in values.enumerate() {
        // Beyond a pitch of 90 degrees roll and yaw turn over.
        let most = match (setting.key, i) {
            ("attitude_rad", 1) => FRAC_PI_2,
            _ => max,
        };
        within(&format!("{}[{i}]", setting.path), value, -most, most)?;
    }
    Ok(())
}

/// Refuses a limit that no number is compared with: it would be no gate, or one that always holds.
fn check_limit(setting: &Setting, limit: Option<f64>, most: f64) -> Result<(), Failure> {
    match limit {
        Some(limit) if !limit.is_finite() || limit > most => Err(outside(setting, limit)),
        _ => Ok(()),
    }
}

fn outside(setting: &Setting, value: impl Display) -> Failure {
    let (path, allowed) = (setting.path, setting.allowed_text());
    Failure::usage(format!("{path} = {value}: allowed are {allowed}"))
        .help("`ironbird fly --print-config` explains every setting")
}

pub(super) fn refused(e: Refused) -> Failure {
    Failure::usage(format!("settings: {e}")).help("see `ironbird fly --print-config`")
}

pub(super) fn within(key: &str, value: f64, min: f64, max: f64) -> Result<(), Failure> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    let [value, min, max] = [value, min, max].map(shown);
    Err(Failure::usage(format!(
        "{key} = {value} is out of range: allowed are {min} to {max}"
    ))
    .help("`ironbird fly --print-config` explains every setting"))
}

/// A value that cannot be read; its key stands in the second line of the error.
fn unreadable(e: &toml::de::Error) -> Failure {
    let what = e.to_string().trim_end().replace('\n', " ");
    // No setting that is a whole number may be negative.
    let what = match (
        what.strip_prefix("invalid value: integer `"),
        what.rsplit('`').nth(1),
    ) {
        (Some(rest), Some(key)) if rest.contains("expected u64") => {
            let value = rest.split('`').next().unwrap_or_default();
            format!(
                "{key} = {value} is out of range: allowed are whole numbers from 0 to {}",
                i64::MAX
            )
        }
        _ => what,
    };
    Failure::usage(format!("settings: {what}")).help("see `ironbird fly --print-config`")
}

/// Refuses a text that would not come back from a report, or would end its line where settings have one each.
fn check_texts(section: &str, table: &Table) -> Result<(), Failure> {
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
    let alone =
        layered(Table::new(), None, overrides).and_then(|table| Settings::from_table(table, false));
    alone.is_err_and(|alone| alone.to_string() == failure.to_string())
}

/// A failure with the name of the flag that set a key, if there is none without that.
pub(super) fn blamed(
    failure: Failure,
    overrides: &Overrides,
    resolved: impl Fn(&Overrides) -> Result<Settings, Failure>,
) -> Failure {
    let flag = overrides
        .iter()
        .find_map(|(flag, _)| overrides::parts(flag).0);
    let Some(flag) = flag.filter(|flag| !failure.to_string().starts_with(*flag)) else {
        return failure;
    };
    let is_plain = |(flag, _): &&(&'static str, Value)| overrides::parts(flag).0.is_none();
    let plain = overrides.iter().filter(is_plain).cloned().collect();
    let alike = resolved(&plain).is_err_and(|other| other.to_string() == failure.to_string());
    match alike {
        true => failure,
        false => failure.append(&format!(" ({flag})")),
    }
}

impl Settings {
    pub(super) fn from_table(table: Table, asks: bool) -> Result<Self, Failure> {
        check_texts("", &table)?;
        let allowed = check_allowed(&table);
        let settings = table
            .try_into::<Self>()
            .map_err(|e| unreadable(&e))?
            .with_points()?;
        allowed?;
        settings.check(asks).map(|()| settings)
    }

    fn check(&self, asks: bool) -> Result<(), Failure> {
        let flight = &self.flight;
        Rig::check_period(flight.period_s).map_err(refused)?;
        let (period_s, duration_s) = (flight.period_s, flight.duration_s);
        within("flight.duration_s", duration_s, period_s, LONGEST_S)?;
        if self.recorder.log_files == 1 {
            return Err(Failure::usage(
                "recorder.log_files = 1 is out of range: allowed are 0, for all, and 2 or more",
            )
            .help("the newest file may have only just begun; `ironbird fly --print-config` explains every setting"));
        }
        self.rig()?.check().map_err(refused)?;
        if let Some(why) = impossible_body(&self.airframe()?.as_built()) {
            return Err(Failure::usage(format!("airframe.{why}"))
                .help("correct the section [airframe]; `ironbird docs airframes` has the format"));
        }
        for role in LAW_ROLES {
            self.check_law(role, asks)?;
        }
        for channel in self.channel.keys() {
            let own = self.of_channel(*channel);
            for role in LAW_ROLES {
                let what = |failure: Failure| failure.append(&format!(" (channel {channel})"));
                own.check_law(role, asks).map_err(what)?;
            }
        }
        if self.recorder.theorem_gate().is_some()
            && let Some(law) = self.law_without_theorem()?
        {
            let key = match self.recorder.gate_theorem {
                true => "gate_theorem",
                false => "gate_theorem_strict",
            };
            return Err(
                Failure::usage(format!("recorder.{key} = true: {}", no_theorem(law))).help(
                    "fly `adaptive` with inner.adaptation = \"on\", or without --gate theorem",
                ),
            );
        }
        if self.recorder.gate_channels && self.rt.channels == 1 {
            return Err(Failure::usage(
                "recorder.gate_channels = true: the flight has one channel, which nothing can be compared with",
            )
            .help("fly with --channels 2 or 3, or without --gate channels"));
        }
        self.check_faults()?;
        self.check_start()?;
        self.realtime()?;
        self.check_length()
    }

    fn check_start(&self) -> Result<(), Failure> {
        // What rounding leaves of a start on the ground.
        const ROUNDING_M: f64 = 1e-9;
        let plant = self.plant()?;
        if plant.ground.is_none() {
            return Ok(());
        }
        match Plant::new(&plant).clearance_m() {
            Some(clearance_m) if clearance_m < -ROUNDING_M => Err(Failure::usage(format!(
                "initial.position_w_m[2] = {} is {:.3} m too low: the airframe would begin in the ground at {} m",
                self.initial.position_w_m[2], -clearance_m, self.flight.ground_z_m
            ))
            .help("begin higher, or set ground.contact = \"off\"")),
            _ => Ok(()),
        }
    }

    /// Refuses settings that do not fit on the blackboard by which the processes of a flight share them.
    fn check_length(&self) -> Result<(), Failure> {
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
