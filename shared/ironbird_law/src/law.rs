//! A law in safe Rust: the trait of each role, its description, settings and telemetry.

use std::error::Error;
use std::fmt;

use crate::abi::{
    self, IronbirdDemand as WrenchSetpoint, IronbirdInnerInput as InnerInput,
    IronbirdMixerInput as MixerInput, IronbirdOuterInput as OuterInput, IronbirdRig as Rig,
    IronbirdRotorSpeeds as RotorSpeeds, IronbirdTelemetry as Telemetry, IronbirdWanted as Desired,
};

/// A role that a law of this type can have.
pub trait RoleOf<L> {
    /// Enters the role and its tick.
    #[doc(hidden)]
    fn enter(table: &mut abi::IronbirdLaw);
}

/// A law of any role. It knows no clock and no operating system.
pub trait Law: Clone + 'static {
    /// [`Outer`](crate::Outer), [`Inner`](crate::Inner) or [`Mixer`](crate::Mixer).
    type Role: RoleOf<Self>;

    /// Its name, settings and telemetry.
    const DESCRIPTION: Description;

    /// The law as it is before tick 0. The rig has checked each setting against the description.
    ///
    /// # Errors
    /// [`Refused`] says what does not go together, with the values, what is allowed and what to do.
    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused>;

    /// Writes what changes in flight into `bytes`, without allocating, and returns how many bytes it wrote; 0 where it
    /// cannot. A law that keeps nothing from one tick to the next writes one byte. A law without this cannot be
    /// reintegrated after a restart of its process.
    fn save(&self, _bytes: &mut [u8]) -> usize {
        0
    }

    /// Continues from what [`Law::save`] of another instance wrote, with the same answers to the last bit. False, and
    /// nothing is changed, where the bytes cannot be its own. The rig has compared the law's name and version.
    fn load(&mut self, _bytes: &[u8]) -> bool {
        false
    }
}

/// The position loop.
pub trait OuterLaw: Law {
    /// Desired thrust and attitude of a tick. It allocates nothing.
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired;
}

/// The attitude and rate loop; or both loops in one, which takes the reference and overrides the desired thrust.
pub trait InnerLaw: Law {
    /// Thrust and torque of a tick. It allocates nothing.
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint;
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerLaw: Law {
    /// Rotor speeds of a tick. It allocates nothing.
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> RotorSpeeds;
}

/// Why a law rejects its settings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused(pub String);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for Refused {}

/// A law, in words.
#[derive(Clone, Copy, Debug)]
pub struct Description {
    /// Its name, as typed by the user, in snake_case.
    pub name: &'static str,
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
    /// What it shows of itself, in the order of [`Telemetry::value`].
    pub telemetry: &'static [Signal],
    /// True if the law gives no real-time guarantee.
    pub not_real_time: bool,
}

impl Description {
    /// An empty description: set at least a name, a version and a summary.
    pub const EMPTY: Self = Self {
        name: "",
        version: "",
        summary: "",
        source: "",
        settings: &[],
        presets: &[],
        telemetry: &[],
        not_real_time: false,
    };
}

/// A number that a law shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Name with unit, as `rate_error_rad_s`.
    pub name: &'static str,
    /// Unit; empty for a ratio.
    pub unit: &'static str,
}

/// A setting of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Name with unit, as `bandwidth_1_s`.
    pub name: &'static str,
    /// Unit; empty for a ratio or a word.
    pub unit: &'static str,
    /// What it is, in a few words.
    pub meaning: &'static str,
    /// Its type, range and default.
    pub kind: SettingKind,
}

/// What a setting may be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    missing_docs,
    reason = "default, least and largest value, of each number"
)]
pub enum SettingKind {
    /// A number from `min` to `max`.
    Number { default: f64, min: f64, max: f64 },
    /// Three numbers.
    Three {
        default: [f64; 3],
        min: f64,
        max: f64,
    },
    /// One of these words; the first is the default.
    Word(&'static [&'static str]),
}

/// A named set of settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preset {
    /// Its name, as typed by the user.
    pub name: &'static str,
    /// What it sets, by the name of the setting.
    pub values: &'static [(&'static str, Value)],
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

/// The settings of a law, each checked against its description.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    values: Vec<(&'static str, Value)>,
}

impl Settings {
    /// Settings by name; a setting that is not given keeps its default.
    #[must_use]
    pub const fn new(values: Vec<(&'static str, Value)>) -> Self {
        Self { values }
    }

    /// A number; NaN where the law has no such setting.
    #[must_use]
    pub fn number(&self, setting: &Setting) -> f64 {
        match self.value(setting) {
            Value::Number(value) => value,
            _ => f64::NAN,
        }
    }

    /// Three numbers; NaN where the law has no such setting.
    #[must_use]
    pub fn three(&self, setting: &Setting) -> [f64; 3] {
        match self.value(setting) {
            Value::Three(value) => value,
            _ => [f64::NAN; 3],
        }
    }

    /// A word; empty where the law has no such setting.
    #[must_use]
    pub fn word(&self, setting: &Setting) -> &'static str {
        match self.value(setting) {
            Value::Word(value) => value,
            _ => "",
        }
    }

    /// The same settings with one of them replaced.
    #[must_use]
    pub fn with(mut self, setting: &Setting, value: Value) -> Self {
        self.values.retain(|(name, _)| *name != setting.name);
        self.values.push((setting.name, value));
        self
    }

    /// The value of a setting, or its default.
    #[must_use]
    pub fn value(&self, setting: &Setting) -> Value {
        let given = self
            .values
            .iter()
            .find(|(name, _)| *name == setting.name)
            .map(|(_, value)| *value);
        given.unwrap_or_else(|| setting.default())
    }
}

impl Setting {
    /// Its default.
    #[must_use]
    pub const fn default(&self) -> Value {
        match self.kind {
            SettingKind::Number { default, .. } => Value::Number(default),
            SettingKind::Three { default, .. } => Value::Three(default),
            SettingKind::Word(words) => match words.first() {
                Some(word) => Value::Word(word),
                None => Value::Word(""),
            },
        }
    }

    /// Whether a value is of its kind and in its range.
    #[must_use]
    pub fn allows(&self, value: &Value) -> bool {
        match (self.kind, value) {
            (SettingKind::Number { min, max, .. }, Value::Number(value)) => {
                (min..=max).contains(value)
            }
            (SettingKind::Three { min, max, .. }, Value::Three(values)) => {
                values.iter().all(|value| (min..=max).contains(value))
            }
            (SettingKind::Word(words), Value::Word(word)) => words.contains(word),
            _ => false,
        }
    }

    /// The values that it allows, as error messages name them.
    #[must_use]
    pub fn allowed(&self) -> String {
        match self.kind {
            SettingKind::Number { min, max, .. } => range(min, max, self.unit),
            SettingKind::Three { min, max, .. } => {
                format!("three numbers, each {}", range(min, max, self.unit))
            }
            SettingKind::Word(words) => {
                let quoted: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
                quoted.join(" or ")
            }
        }
    }

    /// A value of this setting as the C interface has it.
    #[must_use]
    pub fn to_abi(&self, value: &Value) -> abi::IronbirdValue {
        let (number, word) = match (*value, self.kind) {
            (Value::Number(number), _) => ([number, 0.0, 0.0], 0),
            (Value::Three(numbers), _) => (numbers, 0),
            (Value::Word(word), SettingKind::Word(words)) => {
                let found = words.iter().position(|allowed| *allowed == word);
                ([0.0; 3], found.unwrap_or(words.len()) as u64)
            }
            (Value::Word(_), _) => ([f64::NAN; 3], 0),
        };
        abi::IronbirdValue { number, word }
    }

    /// A value of this setting from the C interface; a word out of range is empty.
    #[must_use]
    pub fn from_abi(&self, value: &abi::IronbirdValue) -> Value {
        match self.kind {
            SettingKind::Number { .. } => Value::Number(value.number[0]),
            SettingKind::Three { .. } => Value::Three(value.number),
            SettingKind::Word(words) => {
                let word = usize::try_from(value.word).ok().and_then(|i| words.get(i));
                Value::Word(word.copied().unwrap_or_default())
            }
        }
    }
}

/// Numbers from `min` to `max`, as a phrase.
fn range(min: f64, max: f64, unit: &str) -> String {
    let unit = if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    };
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

impl Telemetry {
    /// The telemetry of a law with this many signals before its first tick: each is NaN (unknown).
    #[must_use]
    pub fn unknown(signals: usize) -> Self {
        let mut telemetry = Self::default();
        telemetry.forget(signals);
        telemetry
    }

    /// Resets it in place to [`Telemetry::unknown`].
    #[inline]
    pub fn forget(&mut self, signals: usize) {
        *self = Self::default();
        self.value[..signals.min(abi::IRONBIRD_TELEMETRY)].fill(f64::NAN);
    }

    /// Sets the numbers after the law's signals to 0.
    #[inline]
    pub fn truncate(&mut self, signals: usize) {
        self.value[signals.min(abi::IRONBIRD_TELEMETRY)..].fill(0.0);
    }

    /// Each signal with its number.
    pub fn of<'a>(&'a self, signals: &'a [Signal]) -> impl Iterator<Item = (&'a Signal, f64)> {
        signals.iter().zip(self.value)
    }
}
