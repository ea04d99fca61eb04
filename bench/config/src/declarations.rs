//! Declares settings: one declaration gives field, default, allowed values, flag and help text of a setting. The settings
//! struct, the commented default, the checks, the command line and docs/settings.md follow from it.

use std::fmt::Write as _;
use std::sync::LazyLock;

use messages::parameters::{Parameter, SPECS, Spec, after_blank, shown};

use toml::{Table, Value};

use crate::settings::{
    FlightSettings, GroundSection, PlantSection, RealtimeSection, RecorderSettings, SimplexSection,
};
use crate::trajectory::TrajectorySection;

/// One setting.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Section and key, as in `flight.seed`.
    pub path: &'static str,
    pub key: &'static str,
    /// The default, as TOML.
    pub default: &'static str,
    pub allowed: Allowed,
    pub flag: Option<Flag>,
    /// The explanation, one line of source per line; an empty line ends the short form.
    pub help: &'static str,
}

/// The values that a setting may have, besides being of the type of its default.
#[derive(Clone, Copy, Debug)]
pub enum Allowed {
    Any,
    /// Least and largest value; of each number, if the setting has several.
    Range(f64, f64),
    /// A few whole numbers.
    Counts(&'static [i64]),
    /// The words, and what each one means.
    OneOf(&'static [(&'static str, &'static str)]),
    /// The limit of a gate; a negative number for no gate.
    Limit,
    /// The limit of a gate on a share [%]; a negative number for no gate.
    Share,
}

/// The flag that sets a setting.
#[derive(Clone, Copy, Debug)]
pub struct Flag {
    pub name: &'static str,
    /// Placeholder of the value in the help text.
    pub value: &'static str,
    pub group: Group,
    pub notation: Notation,
    /// The default in the notation of the flag, if that differs from the setting's.
    pub default: Option<&'static str>,
    /// Help text, if the notation of the flag needs another one.
    pub help: Option<&'static str>,
    /// Whether the flag has no meaning in lockstep, where no clock starts the ticks.
    pub needs_clock: bool,
}

/// Commands take the flags of whole groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Group {
    Flight,
    RealTime,
    Record,
    States,
    /// Gates on timing, which need a clock.
    TimingGates,
    /// Gates on the flight itself.
    FlightGates,
    Channels,
}

/// How a flag's value is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notation {
    /// As the setting itself.
    Plain,
    /// Without a value: the flag sets `true`.
    Switch,
    /// A time with its unit, as in 30s.
    Duration,
    /// A rate, of which the setting is the period.
    Rate,
    /// A whole number, or `auto`.
    WholeOrAuto,
    /// The number of a processor.
    Processor,
    /// A built-in trajectory or a file of points.
    Trajectory,
    /// A preset of a built-in law, or of a law from a file.
    Preset,
}

impl Flag {
    pub(crate) const fn new(name: &'static str, value: &'static str, group: Group) -> Self {
        Self {
            name,
            value,
            group,
            notation: Notation::Plain,
            default: None,
            help: None,
            needs_clock: false,
        }
    }

    pub(crate) const fn written(self, notation: Notation) -> Self {
        Self { notation, ..self }
    }

    pub(crate) const fn default(self, default: &'static str) -> Self {
        Self {
            default: Some(default),
            ..self
        }
    }

    pub(crate) const fn help(self, help: &'static str) -> Self {
        Self {
            help: Some(help),
            ..self
        }
    }

    pub(crate) const fn needs_clock(self) -> Self {
        Self {
            needs_clock: true,
            ..self
        }
    }
}

/// A section of the settings: keys of its own, then parameters of the airframe.
#[derive(Clone, Copy)]
pub(crate) struct Section {
    name: &'static str,
    about: &'static str,
    settings: &'static [Setting],
    has_parameter: fn(Parameter) -> bool,
}

impl Section {
    pub(crate) const fn new(
        name: &'static str,
        about: &'static str,
        settings: &'static [Setting],
    ) -> Self {
        Self {
            name,
            about,
            settings,
            has_parameter: |_| false,
        }
    }

    pub(crate) const fn with(self, has_parameter: fn(Parameter) -> bool) -> Self {
        Self {
            has_parameter,
            ..self
        }
    }

    fn parameters(&self) -> impl Iterator<Item = &'static Spec> {
        let has = |spec: &&Spec| (self.has_parameter)(spec.parameter);
        SPECS.iter().filter(has)
    }
}

/// Declares a section: name and explanation, and of each setting help text, key, type, default as TOML, allowed values,
/// flag. With a struct, it gets a field per setting, and the constant `SECTION`; with `rows`, it is a [`Section`].
macro_rules! section {
    (
        $section:literal $about:literal
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $(
                $(#[doc = $help:literal])+
                $key:ident: $type:ty = $default:literal $(, in $allowed:expr)? $(, flag $flag:expr)?;
            )+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[doc = $help])+ pub $key: $type,)+
        }

        impl $name {
            pub(crate) const SECTION: $crate::declarations::Section = $crate::declarations::section! {
                rows $section $about $($(#[doc = $help])+ $key = $default $(, in $allowed)? $(, flag $flag)?;)+
            };
        }
    };
    (
        rows $section:literal $about:literal
        $(
            $(#[doc = $help:literal])+
            $key:ident = $default:literal $(, in $allowed:expr)? $(, flag $flag:expr)?;
        )+
    ) => {
        $crate::declarations::Section::new($section, $about, &[$($crate::declarations::Setting {
            path: concat!($section, ".", stringify!($key)),
            key: stringify!($key),
            default: $default,
            allowed: $crate::declarations::section!(@or $crate::declarations::Allowed::Any $(, $allowed)?),
            flag: $crate::declarations::section!(@or None $(, Some($flag))?),
            help: concat!($($help, "\n"),+),
        }),+])
    };
    (@or $else:expr, $given:expr) => { $given };
    (@or $else:expr) => { $else };
}
pub(crate) use section;

const INITIAL: Section = section! { rows "initial" "State at tick 0; the rotors turn at hover speed."
    /// Position [m].
    position_w_m = "[0.0, 0.0, 0.0]", in Allowed::Range(-1e4, 1e4);
    /// Velocity [m/s].
    velocity_w_m_s = "[0.0, 0.0, 0.0]", in Allowed::Range(-100.0, 100.0);
    /// Roll, pitch and yaw [rad]; the pitch is at most 90 degrees.
    attitude_rad = "[0.0, 0.0, 0.0]", in Allowed::Range(-std::f64::consts::PI, std::f64::consts::PI);
    /// Body rates [rad/s].
    rate_b_rad_s = "[0.0, 0.0, 0.0]", in Allowed::Range(-100.0, 100.0);
};

const ROTOR: Section = section! { rows "rotor" "Range of the rotor speeds."
    /// Idle speed [rad/s].
    min_rad_s = "30.0";
    /// Largest speed [rad/s].
    max_rad_s = "350.0";
};

/// The laws estimate the other parameters of the airframe, or do without.
const MODEL: Section = Section::new(
    "model",
    "The airframe as the laws know it. Changes in flight do not affect it. I_R, k_r and delta are not included: the \
     inner law `adaptive` estimates them.",
    &[],
)
.with(|parameter| {
    use Parameter::{
        ArmLength, DragFactor, Gravity, InertiaX, InertiaY, InertiaZ, Mass, ThrustCoefficient,
        TranslationalDrag,
    };
    matches!(
        parameter,
        Mass | Gravity
            | TranslationalDrag
            | ArmLength
            | ThrustCoefficient
            | DragFactor
            | InertiaX
            | InertiaY
            | InertiaZ
    )
});

/// The sections in the order of a settings file. Those of the laws follow them.
const SECTIONS: [Section; 10] = [
    FlightSettings::SECTION,
    INITIAL,
    GroundSection::SECTION,
    TrajectorySection::SECTION,
    PlantSection::SECTION,
    MODEL,
    ROTOR,
    RealtimeSection::SECTION,
    SimplexSection::SECTION,
    RecorderSettings::SECTION,
];

/// All settings except airframe parameters and laws' own.
pub fn settings() -> impl Iterator<Item = &'static Setting> {
    SECTIONS.into_iter().flat_map(|section| section.settings)
}

impl Setting {
    /// The first paragraph of the explanation, and all of it.
    pub fn explanations(&self) -> (String, String) {
        let lines: Vec<&str> = self.help.lines().map(str::trim).collect();
        let paragraphs: Vec<String> = lines
            .split(|line| line.is_empty())
            .map(|lines| lines.join(" "))
            .filter(|paragraph| !paragraph.is_empty())
            .collect();
        let first = paragraphs.first().cloned().unwrap_or_default();
        (first, paragraphs.join("\n\n"))
    }

    /// The allowed values, in words; empty if the type says all.
    pub fn allowed_text(&self) -> String {
        match self.allowed {
            Allowed::Any => String::new(),
            Allowed::Range(min, max) => format!("{} to {}", shown(min), shown(max)),
            Allowed::Counts(counts) => {
                let counts: Vec<String> = counts.iter().map(i64::to_string).collect();
                counts.join(", ")
            }
            Allowed::OneOf(words) => {
                let words: Vec<&str> = words.iter().map(|(word, _)| *word).collect();
                words.join(", ")
            }
            Allowed::Limit => "0 and more, and a negative number for no gate".into(),
            Allowed::Share => "0 to 100, and a negative number for no gate".into(),
        }
    }
}

/// The commented default: what `--print-config` prints if nothing is set.
pub static DEFAULT: LazyLock<String> = LazyLock::new(|| commented(&Table::new()));

/// Settings with these values, as a file that explains each key; those of laws and the airframe are missing.
pub(crate) fn commented(values: &Table) -> String {
    let mut text = "# Settings of ironbird. Every key is optional and has the default shown here. Relative paths start at \
                    the folder of their file.\n"
        .to_owned();
    for section in SECTIONS {
        text += "\n";
        comment(&mut text, section.about);
        let _ = writeln!(text, "[{}]", section.name);
        let own = values.get(section.name);
        // An unchanged value keeps the way it is written: 2e-4, not 0.0002.
        let value = |key: &str, default: &str| {
            let is_changed = |value: &&Value| default.parse().ok().as_ref() != Some(*value);
            let value = own.and_then(|own| own.get(key)).filter(is_changed);
            value.map_or_else(|| default.to_owned(), Value::to_string)
        };
        for setting in section.settings {
            comment(&mut text, &with_allowed(setting));
            let value = value(setting.key, setting.default);
            let _ = writeln!(text, "{} = {value}", setting.key);
        }
        for spec in section.parameters() {
            let (unit, name) = (after_blank(spec.unit), spec.name);
            let value = value(name, &format!("{:?}", spec.nominal));
            let _ = writeln!(text, "{name} = {value} # {}{unit}", spec.meaning);
        }
    }
    text
}

fn with_allowed(setting: &Setting) -> String {
    let (first, _) = setting.explanations();
    let meanings = match setting.allowed {
        Allowed::OneOf(words) => words
            .iter()
            .map(|(word, meaning)| format!("\n{word}: {meaning}"))
            .collect(),
        Allowed::Range(..) | Allowed::Counts(_) => format!(" Allowed: {}.", setting.allowed_text()),
        Allowed::Any | Allowed::Limit | Allowed::Share => String::new(),
    };
    first + &meanings
}

/// Appends a comment in lines of at most 120 characters.
fn comment(text: &mut String, comment: &str) {
    for line in comment.lines().flat_map(|line| textwrap::wrap(line, 118)) {
        let _ = writeln!(text, "# {line}");
    }
}

/// The page docs/settings.md.
pub fn page() -> String {
    let mut page = "# Settings\n\nEvery setting with its default, its allowed values and the flag that sets it. A settings \
                    file (`--config FILE`) has the same sections; `--set SECTION.KEY=VALUE` sets one key; `ironbird fly \
                    --print-config` prints the settings of a flight. The declarations in `bench/config/src` generate this \
                    page.\n"
        .to_owned();
    let cell = |text: &str| text.replace('|', "\\|");
    for section in SECTIONS {
        let Section {
            name,
            about,
            settings,
            ..
        } = section;
        let _ = write!(page, "\n## [{name}]\n\n{about}\n\n");
        if !settings.is_empty() {
            page += "| key | default | allowed | flag | meaning |\n|---|---|---|---|---|\n";
        }
        for setting in settings {
            let flag = setting.flag.map_or(String::new(), |flag| {
                format!("`{} {}`", flag.name, flag.value).replace(" `", "`")
            });
            let (meaning, allowed) = (setting.explanations().0, setting.allowed_text());
            let cells = [
                setting.key,
                &format!("`{}`", setting.default),
                &allowed,
                &flag,
                &meaning,
            ];
            let _ = writeln!(page, "| {} |", cells.map(cell).join(" | "));
        }
        let has_parameters = section.parameters().next().is_some();
        if !settings.is_empty() && has_parameters {
            page += "\n";
        }
        if has_parameters {
            page += "| key | default | unit | range | meaning |\n|---|---|---|---|---|\n";
        }
        for spec in section.parameters() {
            let (name, nominal, unit, meaning) = (spec.name, spec.nominal, spec.unit, spec.meaning);
            let (min, max) = (shown(spec.min), shown(spec.max));
            let _ = writeln!(
                page,
                "| {name} | `{nominal:?}` | {unit} | {min} to {max} | {meaning} |"
            );
        }
    }
    page += "\n## [outer], [inner], [mixer]\n\nThe key `law` names the law (`--outer`, `--inner`, `--mixer`). `ironbird laws NAME` \
             explains the settings of a law.\n";
    page
}
