//! A law that is built outside of the rig: the C interface, and the same in safe Rust.
//!
//! In Rust a law is a type with [`Law`] and the trait of its role, and one line that exports it:
//!
//! ```
//! use ironbird_law::{Demand, Description, Inner, InnerInput, InnerLaw, Law, Refused, Rig, Settings, Telemetry};
//!
//! #[derive(Clone)]
//! struct Level;
//!
//! impl Law for Level {
//!     type Role = Inner;
//!     const DESCRIPTION: Description = Description {
//!         name: "level",
//!         version: "1",
//!         summary: "asks for the thrust wanted and no torque",
//!         ..Description::EMPTY
//!     };
//!
//!     fn new(_: &Rig, _: &Settings) -> Result<Self, Refused> {
//!         Ok(Self)
//!     }
//! }
//!
//! impl InnerLaw for Level {
//!     fn tick(&mut self, input: &InnerInput, _: &mut Telemetry) -> Demand {
//!         Demand { thrust_n: input.wanted.thrust_n, torque_b_nm: [0.0; 3] }
//!     }
//! }
//!
//! ironbird_law::export!(Level);
//! ```
//!
//! Such a crate has `crate-type = ["cdylib"]`. A panic in `new` is a refusal with its text; a panic in a tick prints its
//! text and ends the process, as it must not run through the rig. This crate depends on nothing, and is copied as it is.

pub mod abi;
mod border;

pub use abi::{
    IronbirdAirframe as Airframe, IronbirdDemand as Demand, IronbirdInnerInput as InnerInput,
    IronbirdMeasured as Measured, IronbirdMixerInput as MixerInput, IronbirdOuterInput as OuterInput,
    IronbirdReference as Reference, IronbirdRig as Rig, IronbirdRotorSpeeds as RotorSpeeds,
    IronbirdTelemetry as Telemetry, IronbirdWanted as Wanted,
};
#[doc(hidden)]
pub use border::table;
pub use border::{Inner, Mixer, Outer, RoleOf};

/// A law of any role. It knows no clock and no operating system.
pub trait Law: Clone + 'static {
    /// [`Outer`], [`Inner`] or [`Mixer`].
    type Role: RoleOf<Self>;

    /// Its name, settings and telemetry.
    const DESCRIPTION: Description;

    /// The law as it is before tick 0. The rig has checked each setting against the description.
    ///
    /// # Errors
    /// [`Refused`] says what does not go together, with the values, what is allowed and what to do.
    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused>;
}

/// The position loop.
pub trait OuterLaw: Law {
    /// What is wanted at a tick. It allocates nothing.
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Wanted;
}

/// The attitude and rate loop; or both loops in one, which takes the reference and overrides the thrust wanted.
pub trait InnerLaw: Law {
    /// Thrust and torque of a tick. It allocates nothing.
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> Demand;
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerLaw: Law {
    /// Rotor speeds of a tick. It allocates nothing.
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> RotorSpeeds;
}

/// A law does not take its settings, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused(pub String);

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
    /// Whether it promises nothing about its time.
    pub not_real_time: bool,
}

impl Description {
    /// Nothing said: to be completed with at least a name, a version and a summary.
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
    /// What it may be, and what it is when nothing is said.
    pub kind: SettingKind,
}

/// What a setting may be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "default, least and largest value, of each number")]
pub enum SettingKind {
    /// A number from `min` to `max`.
    Number { default: f64, min: f64, max: f64 },
    /// Three numbers.
    Three { default: [f64; 3], min: f64, max: f64 },
    /// One of some words; the first is the default.
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
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    values: Vec<(&'static str, Value)>,
}

impl Settings {
    /// Settings by name.
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

    fn value(&self, setting: &Setting) -> Value {
        let given = self.values.iter().find(|(name, _)| *name == setting.name).map(|(_, value)| *value);
        given.unwrap_or_else(|| setting.default())
    }
}

impl Setting {
    /// Its value when nothing is said.
    #[must_use]
    pub fn default(&self) -> Value {
        match self.kind {
            SettingKind::Number { default, .. } => Value::Number(default),
            SettingKind::Three { default, .. } => Value::Three(default),
            SettingKind::Word(words) => Value::Word(words.first().copied().unwrap_or_default()),
        }
    }
}

/// Exports a law, a type with [`Law`], from a library. One per library.
#[macro_export]
macro_rules! export {
    ($law:ty) => {
        #[unsafe(no_mangle)]
        extern "C" fn ironbird_law() -> *const $crate::abi::IronbirdLaw {
            static TABLE: ::std::sync::OnceLock<$crate::abi::IronbirdLaw> = ::std::sync::OnceLock::new();
            TABLE.get_or_init($crate::table::<$law>)
        }
    };
}
