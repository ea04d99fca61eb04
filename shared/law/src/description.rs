//! What a law says of itself: name, source, settings, telemetry.
//!
//! A setting is declared once, as a constant of the law's file. The rig reads it from the law's section of the settings,
//! checks it, and hands it over; the law looks it up by the same constant.

use model::role::Role;
use model::telemetry::{TELEMETRY, Telemetry};

/// A law, in words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Its name, as typed by the user.
    pub name: &'static str,
    /// Its role.
    pub role: Role,
    /// Its own version: whatever changes its outputs changes this.
    pub version: &'static str,
    /// What it is for, in a sentence.
    pub summary: &'static str,
    /// Where it comes from: authors, title, year, equations.
    pub source: &'static str,
    /// Its settings.
    pub settings: &'static [Setting],
    /// Named sets of settings; what a set does not name keeps its default.
    pub presets: &'static [Preset],
    /// What it shows of itself, in the order of [`Telemetry::value`]; at most [`TELEMETRY`].
    pub telemetry: &'static [Signal],
}

/// A number that a law shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Name with unit, as `v_th_rad2_s2`.
    pub name: &'static str,
    /// Unit; empty for a ratio.
    pub unit: &'static str,
}

/// A setting of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Name with unit, as `alpha_1_s`.
    pub name: &'static str,
    /// Unit; empty for a ratio or a word.
    pub unit: &'static str,
    /// What it is, in a few words.
    pub meaning: &'static str,
    /// What it may be, and what it is when nothing is said.
    pub kind: SettingKind,
}

/// What a setting may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SettingKind {
    /// A number from `min` to `max`.
    Number {
        /// When nothing is said.
        default: f64,
        /// Least value allowed.
        min: f64,
        /// Largest value allowed.
        max: f64,
    },
    /// Three numbers: x, y, z, or roll, pitch, yaw, or the three estimates.
    Three {
        /// When nothing is said.
        default: [f64; 3],
        /// Least value allowed, of each.
        min: f64,
        /// Largest value allowed, of each.
        max: f64,
    },
    /// One of some words.
    Word {
        /// When nothing is said.
        default: &'static str,
        /// What is allowed.
        words: &'static [&'static str],
    },
}

/// A value of a setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Of [`SettingKind::Number`].
    Number(f64),
    /// Of [`SettingKind::Three`].
    Three([f64; 3]),
    /// Of [`SettingKind::Word`].
    Word(&'static str),
}

/// A named set of settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preset {
    /// Its name, as typed by the user.
    pub name: &'static str,
    /// What it sets, by name.
    pub values: &'static [(&'static str, Value)],
}

/// The settings of one law, each checked against its description.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    values: Vec<(&'static str, Value)>,
}

/// A law does not take its settings.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

impl Settings {
    /// Those that are given by name; a setting that is not given keeps its default.
    #[must_use]
    pub const fn new(values: Vec<(&'static str, Value)>) -> Self {
        Self { values }
    }

    /// A number.
    #[must_use]
    pub fn number(&self, setting: &Setting) -> f64 {
        match (self.given(setting), setting.kind) {
            (Some(Value::Number(value)), _) | (_, SettingKind::Number { default: value, .. }) => value,
            _ => f64::NAN,
        }
    }

    /// Three numbers.
    #[must_use]
    pub fn three(&self, setting: &Setting) -> [f64; 3] {
        match (self.given(setting), setting.kind) {
            (Some(Value::Three(value)), _) | (_, SettingKind::Three { default: value, .. }) => value,
            _ => [f64::NAN; 3],
        }
    }

    /// A word.
    #[must_use]
    pub fn word(&self, setting: &Setting) -> &'static str {
        match (self.given(setting), setting.kind) {
            (Some(Value::Word(value)), _) | (_, SettingKind::Word { default: value, .. }) => value,
            _ => "",
        }
    }

    fn given(&self, setting: &Setting) -> Option<Value> {
        self.values.iter().find(|(name, _)| *name == setting.name).map(|(_, value)| *value)
    }
}

impl Description {
    /// The numbers of a tick, each with its signal.
    pub fn shown<'a>(&self, telemetry: &'a Telemetry) -> impl Iterator<Item = (&'static Signal, f64)> + 'a {
        self.telemetry.iter().zip(telemetry.value).take(TELEMETRY)
    }
}
