//! What a law says of itself: name, source, settings, telemetry.
//!
//! A setting is declared once, as a constant of the law's file. The rig reads it from the law's section of the settings,
//! checks it, and hands it over; the law looks it up by the same constant.

use model::role::Role;
pub use model::telemetry::Signal;
use model::telemetry::TELEMETRY;

use crate::rig::Rig;

/// A law, in words.
#[derive(Clone, Copy, Debug)]
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
    /// How defaults and presets follow the airframe; none where they fit every airframe as they are.
    pub suited: Option<Suited>,
    /// What it shows of itself, in the order of [`model::telemetry::Telemetry::value`]; at most [`TELEMETRY`].
    pub telemetry: &'static [Signal],
}

/// Settings that do for a rig what the given ones, a law's default or preset, do for [`Rig::default`]. What the user
/// sets stays as it is.
pub type Suited = fn(&Settings, &Rig) -> Settings;

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

impl Setting {
    /// Whether a value is of its kind and in its range.
    #[must_use]
    pub fn allows(&self, value: &Value) -> bool {
        match (self.kind, value) {
            (SettingKind::Number { min, max, .. }, Value::Number(value)) => (min..=max).contains(value),
            (SettingKind::Three { min, max, .. }, Value::Three(values)) => {
                values.iter().all(|value| (min..=max).contains(value))
            }
            (SettingKind::Word { words, .. }, Value::Word(word)) => words.contains(word),
            _ => false,
        }
    }

    /// What is allowed, in words.
    #[must_use]
    pub fn allowed(&self) -> String {
        match self.kind {
            SettingKind::Number { min, max, .. } => range(min, max, self.unit),
            SettingKind::Three { min, max, .. } => format!("three numbers, each {}", range(min, max, self.unit)),
            SettingKind::Word { words, .. } => {
                words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(" or ")
            }
        }
    }

    /// Its value when nothing is said.
    #[must_use]
    pub const fn default(&self) -> Value {
        match self.kind {
            SettingKind::Number { default, .. } => Value::Number(default),
            SettingKind::Three { default, .. } => Value::Three(default),
            SettingKind::Word { default, .. } => Value::Word(default),
        }
    }
}

/// Numbers from `min` to `max`, in words.
fn range(min: f64, max: f64, unit: &str) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    if max < f64::MAX {
        format!("{min} to {max}{unit}")
    } else if min == f64::MIN_POSITIVE {
        "a finite number above 0".into()
    } else if min == f64::MIN {
        "a finite number".into()
    } else {
        format!("{min}{unit} or a finite number above it")
    }
}

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

    /// The same, but for one of them.
    #[must_use]
    pub fn with(mut self, setting: &Setting, value: Value) -> Self {
        self.values.retain(|(name, _)| *name != setting.name);
        self.values.push((setting.name, value));
        self
    }

    fn given(&self, setting: &Setting) -> Option<Value> {
        self.values.iter().find(|(name, _)| *name == setting.name).map(|(_, value)| *value)
    }
}

impl Description {
    /// The settings of one of its presets; none where it has no preset of that name.
    #[must_use]
    pub fn preset(&self, name: &str) -> Option<Settings> {
        self.presets.iter().find(|preset| preset.name == name).map(|preset| Settings::new(preset.values.to_vec()))
    }

    /// What is wrong with the names of its signals: they are columns, fields and plots of whatever shows a flight.
    #[must_use]
    pub fn flaws(&self) -> Vec<String> {
        let Self { name: law, telemetry, .. } = self;
        let mut flaws = Vec::new();
        if telemetry.len() > TELEMETRY {
            flaws.push(format!("`{law}` shows {} signals: allowed are {TELEMETRY}", telemetry.len()));
        }
        for (i, Signal { name, unit }) in telemetry.iter().enumerate() {
            if telemetry[..i].iter().any(|earlier| earlier.name == *name) {
                flaws.push(format!("`{law}` shows `{name}` twice: every signal has a name of its own"));
            }
            if !is_snake_case(name) || *name == TICK {
                flaws.push(format!("`{law}` shows `{name}`: a name is in snake_case, and not `{TICK}`"));
            }
            let suffix = suffix(unit);
            if !name.ends_with(&suffix) {
                flaws.push(format!("`{law}` shows `{name}` in {unit}: such a name ends in `{suffix}`"));
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
    let word = |word: &str| !word.is_empty() && word.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
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
            Signal { name: "v_th_rad2_s2", unit: "rad^2/s^2" },
            Signal { name: "rotational_drag_nm_s", unit: "N m s" },
            Signal { name: "rotor_inertia_kg_m2", unit: "kg m^2" },
            Signal { name: "drag_1_s", unit: "1/s" },
            Signal { name: "thrust_n", unit: "N" },
            Signal { name: "saturated", unit: "" },
        ];
        assert_eq!(flaws(GOOD), Vec::<String>::new());
    }

    #[test]
    fn each_flaw_is_named_with_what_is_allowed() {
        const MANY: [Signal; TELEMETRY + 1] = [Signal { name: "a", unit: "" }; TELEMETRY + 1];
        let said = flaws(&MANY);
        assert_eq!(said[0], "`named` shows 33 signals: allowed are 32");
        assert_eq!(said[1], "`named` shows `a` twice: every signal has a name of its own");
        for (name, unit, flaw) in [
            ("rate", "rad/s", "`named` shows `rate` in rad/s: such a name ends in `_rad_s`"),
            ("Rate_rad_s", "rad/s", "`named` shows `Rate_rad_s`: a name is in snake_case, and not `tick`"),
            ("rate__x", "", "`named` shows `rate__x`: a name is in snake_case, and not `tick`"),
            ("1st", "", "`named` shows `1st`: a name is in snake_case, and not `tick`"),
            ("tick", "", "`named` shows `tick`: a name is in snake_case, and not `tick`"),
            ("", "", "`named` shows ``: a name is in snake_case, and not `tick`"),
        ] {
            let signals: &'static [Signal] = Box::leak(Box::new([Signal { name, unit }]));
            assert_eq!(flaws(signals), [flaw], "{name}");
        }
    }
}
