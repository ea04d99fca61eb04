//! What a law says of itself: name, source, settings, telemetry.
//!
//! A setting is declared once, as a constant of the law's file. The rig reads it from the law's section of the settings,
//! checks it, and hands it over; the law looks it up by the same constant.

pub use ironbird_law::{Preset, Refused, Setting, SettingKind, Settings, Signal, Value};
use messages::layout::{FNV_OFFSET, fnv1a};
use messages::role::Role;
use messages::telemetry::TELEMETRY;

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
    /// What it shows of itself, in the order of [`messages::telemetry::Telemetry::value`]; at most [`TELEMETRY`].
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

    /// What is wrong with the names of its signals: they are columns, fields and plots of whatever shows a flight.
    pub fn flaws(&self) -> Vec<String> {
        let (law, telemetry) = (self.name, self.telemetry);
        let mut flaws = Vec::new();
        if telemetry.len() > TELEMETRY {
            flaws.push(format!(
                "`{law}` shows {} signals: allowed are {TELEMETRY}",
                telemetry.len()
            ));
        }
        for (i, Signal { name, unit }) in telemetry.iter().enumerate() {
            if telemetry[..i].iter().any(|earlier| earlier.name == *name) {
                flaws.push(format!(
                    "`{law}` shows `{name}` twice: every signal has a name of its own"
                ));
            }
            if !is_snake_case(name) || *name == TICK {
                flaws.push(format!(
                    "`{law}` shows `{name}`: a name is in snake_case, and not `{TICK}`"
                ));
            }
            let suffix = suffix(unit);
            if !name.ends_with(&suffix) {
                flaws.push(format!(
                    "`{law}` shows `{name}` in {unit}: such a name ends in `{suffix}`"
                ));
            }
        }
        flaws
    }
}

/// What a message of telemetry begins with, so that no signal is called so.
pub const TICK: &str = "tick";

/// What the name of a number of this unit ends in: `_rad_s2` for rad/s^2.
fn suffix(unit: &str) -> String {
    if unit.is_empty() {
        return String::new();
    }
    let letters = unit.replace("N m", "nm").replace('N', "n").replace('^', "");
    format!("_{}", letters.replace([' ', '/'], "_"))
}

fn is_snake_case(name: &str) -> bool {
    let word = |word: &str| {
        !word.is_empty()
            && word
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit())
    };
    name.starts_with(|c: char| c.is_ascii_lowercase()) && name.split('_').all(word)
}

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

    fn flaws(telemetry: &'static [Signal]) -> Vec<String> {
        Description { telemetry, ..NAMED }.flaws()
    }

    #[test]
    fn good_names_have_no_flaw() {
        const GOOD: &[Signal] = &[
            signal("v_th_rad2_s2", "rad^2/s^2"),
            signal("rotational_drag_nm_s", "N m s"),
            signal("rotor_inertia_kg_m2", "kg m^2"),
            signal("drag_1_s", "1/s"),
            signal("thrust_n", "N"),
            signal("saturated", ""),
        ];
        assert_eq!(flaws(GOOD), Vec::<String>::new());
    }

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

    #[test]
    fn each_flaw_is_named_with_what_is_allowed() {
        const MANY: [Signal; TELEMETRY + 1] = [signal("a", ""); TELEMETRY + 1];
        let found = flaws(&MANY);
        assert_eq!(found[0], "`named` shows 33 signals: allowed are 32");
        let twice = "`named` shows `a` twice: every signal has a name of its own";
        assert_eq!(found[1], twice);
        let suffix = "`named` shows `rate` in rad/s: such a name ends in `_rad_s`";
        const NO_SUFFIX: &[Signal] = &[signal("rate", "rad/s")];
        assert_eq!(flaws(NO_SUFFIX), [suffix]);
        const NAMES: [Signal; 5] = [
            signal("Rate_rad_s", "rad/s"),
            signal("rate__x", ""),
            signal("1st", ""),
            signal("tick", ""),
            signal("", ""),
        ];
        let expected = NAMES.map(|Signal { name, .. }| {
            format!("`named` shows `{name}`: a name is in snake_case, and not `tick`")
        });
        assert_eq!(flaws(&NAMES), expected);
    }
}
