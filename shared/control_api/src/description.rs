//! What a law says of itself: name, source, settings, telemetry.
//!
//! A setting is declared once, as a constant of the law's file. The rig reads it from the law's section of the settings,
//! checks it, and hands it over; the law looks it up by the same constant.

pub use ironbird_law::{Preset, Refused, Setting, SettingKind, Settings, Signal, Value};
use messages::layout::{FNV_OFFSET, fnv1a};
use messages::role::Role;

use crate::rig::Rig;

pub const fn signal(name: &'static str, unit: &'static str) -> Signal {
    Signal { name, unit }
}

/// The signals of a vector: `xyz!("bias", "rad_s2", "rad/s^2")` are `bias_x_rad_s2`, `bias_y_rad_s2` and `bias_z_rad_s2`.
#[macro_export]
macro_rules! xyz {
    ($name:literal, $ending:literal, $unit:literal) => {
        [
            $crate::description::signal(concat!($name, "_x_", $ending), $unit),
            $crate::description::signal(concat!($name, "_y_", $ending), $unit),
            $crate::description::signal(concat!($name, "_z_", $ending), $unit),
        ]
    };
}
pub use xyz;

/// The kind of a setting that is one number from `min` to `max`.
pub const fn number(default: f64, min: f64, max: f64) -> SettingKind {
    SettingKind::Number { default, min, max }
}

/// The kind of a setting that is three numbers, each from `min` to `max`.
pub const fn three(default: [f64; 3], min: f64, max: f64) -> SettingKind {
    SettingKind::Three { default, min, max }
}

/// Declares the settings of a law as constants: name with unit, unit, kind, and meaning; with `NAME;` before them also
/// the list of all.
#[macro_export]
macro_rules! settings {
    ($of_all:vis $all:ident; $($vis:vis $constant:ident = $name:literal, $unit:literal, $kind:expr, $meaning:literal;)+) => {
        $crate::settings! { $($vis $constant = $name, $unit, $kind, $meaning;)+ }
        $of_all const $all: &[$crate::description::Setting] = &[$($constant),+];
    };
    ($($vis:vis $constant:ident = $name:literal, $unit:literal, $kind:expr, $meaning:literal;)+) => {
        $($vis const $constant: $crate::description::Setting = $crate::description::Setting {
            name: $name,
            unit: $unit,
            meaning: $meaning,
            kind: $kind,
        };)+
    };
}
pub use settings;

#[derive(Clone, Copy, Debug)]
pub struct Description {
    pub name: &'static str,
    pub role: Role,
    /// Its own version: whatever changes its outputs changes this.
    pub version: &'static str,
    pub summary: &'static str,
    /// Where it comes from: authors, title, year, equations.
    pub source: &'static str,
    pub settings: &'static [Setting],
    /// Named sets of settings; what a set does not name keeps its default.
    pub presets: &'static [Preset],
    /// How defaults and presets follow the airframe; none where they fit every airframe as they are.
    pub suited: Option<Suited>,
    /// The signals of its telemetry, in the order of [`messages::telemetry::Telemetry::value`].
    pub telemetry: &'static [Signal],
}

/// Settings that do for a rig what the given ones, a law's default or preset, do for [`Rig::default`]. What the user
/// sets stays as it is.
pub type Suited = fn(&Settings, &Rig) -> Settings;

impl Description {
    /// The settings of one of its presets; none where it has no preset of that name.
    pub fn preset(&self, name: &str) -> Option<Settings> {
        self.presets
            .iter()
            .find(|preset| preset.name == name)
            .map(|preset| Settings::new(preset.values.to_vec()))
    }

    /// What a saved state of this law begins with: a hash of the format, the law and its version.
    pub fn state_hash(&self) -> u64 {
        let words = ["saved state 1", self.role.name(), self.name, self.version];
        words.iter().fold(FNV_OFFSET, |hash, word| {
            fnv1a(fnv1a(hash, word.as_bytes()), b"\n")
        })
    }
}

/// What a message of telemetry begins with, so that no signal is called so.
pub const TICK: &str = "tick";

#[cfg(test)]
mod tests {
    use super::*;

    const NAMED: Description = Description {
        name: "named",
        role: Role::Inner,
        version: "1",
        summary: "",
        source: "",
        settings: &[],
        presets: &[],
        suited: None,
        telemetry: &[],
    };

    #[test]
    fn another_law_or_version_has_another_state_hash() {
        let (name, version) = ("other", "2");
        let others = [
            Description { name, ..NAMED },
            Description { version, ..NAMED },
        ];
        assert!(
            others
                .iter()
                .all(|other| other.state_hash() != NAMED.state_hash())
        );
    }
}
