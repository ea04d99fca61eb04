//! Declares settings: one declaration gives field, default, allowed values, flag and help text of a setting. The settings
//! struct, the commented default, the checks, the command line and docs/settings.md follow from it.

use std::fmt::Write as _;
use std::sync::LazyLock;

use messages::parameters::{Parameter, SPECS, after_blank, shown};

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

/// Declares the settings of a section: help text, key, type, default as TOML, allowed values, flag. With a struct, it
/// gets a field per setting, and the constant `SETTINGS`; without one, the settings become a constant of that name.
macro_rules! section {
    (
        $section:literal
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $(
                $(#[doc = $help:literal])+
                $(#[serde $serde:tt])?
                $key:ident: $type:ty = $default:literal $(, in $allowed:expr)? $(, flag $flag:expr)?;
            )+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[doc = $help])+ $(#[serde $serde])? pub $key: $type,)+
        }

        impl $name {
            pub(crate) const SETTINGS: &[$crate::declarations::Setting] = $crate::declarations::section! {
                rows $section $($(#[doc = $help])+ $key = $default $(, in $allowed)? $(, flag $flag)?;)+
            };
        }
    };
    (
        rows $section:literal
        $(
            $(#[doc = $help:literal])+
            $key:ident = $default:literal $(, in $allowed:expr)? $(, flag $flag:expr)?;
        )+
    ) => {
        &[$($crate::declarations::Setting {
            path: concat!($section, ".", stringify!($key)),
            key: stringify!($key),
            default: $default,
            allowed: $crate::declarations::section!(@or $crate::declarations::Allowed::Any $(, $allowed)?),
            flag: $crate::declarations::section!(@or None $(, Some($flag))?),
            help: concat!($($help, "\n"),+),
        }),+]
    };
    (@or $else:expr, $given:expr) => { $given };
    (@or $else:expr) => { $else };
}
pub(crate) use section;

const INITIAL: &[Setting] = section! { rows "initial"
    /// Position [m].
    position_w_m = "[0.0, 0.0, 0.0]", in Allowed::Range(-1e4, 1e4);
    /// Velocity [m/s].
    velocity_w_m_s = "[0.0, 0.0, 0.0]", in Allowed::Range(-100.0, 100.0);
    /// Roll, pitch and yaw [rad]; the pitch is at most 90 degrees.
    attitude_rad = "[0.0, 0.0, 0.0]", in Allowed::Range(-std::f64::consts::PI, std::f64::consts::PI);
    /// Body rates [rad/s].
    rate_b_rad_s = "[0.0, 0.0, 0.0]", in Allowed::Range(-100.0, 100.0);
};

const ROTOR: &[Setting] = section! { rows "rotor"
    /// Idle speed [rad/s].
    min_rad_s = "30.0";
    /// Largest speed [rad/s].
    max_rad_s = "350.0";
};

/// Airframe parameters that the laws know. They estimate the others, or do without.
const MODEL: [Parameter; 9] = [
    Parameter::Mass,
    Parameter::Gravity,
    Parameter::TranslationalDrag,
    Parameter::ArmLength,
    Parameter::ThrustCoefficient,
    Parameter::DragFactor,
    Parameter::InertiaX,
    Parameter::InertiaY,
    Parameter::InertiaZ,
];

/// Content of a section: settings, then parameters of the airframe.
struct Rows(&'static [Setting], Vec<Parameter>);

/// The sections with their explanations, in the order of a settings file. Those of the laws follow them.
static SECTIONS: LazyLock<[(&str, &str, Rows); 10]> = LazyLock::new(|| {
    [
        (
            "flight",
            "The flight.",
            Rows(FlightSettings::SETTINGS, Vec::new()),
        ),
        (
            "initial",
            "State at tick 0; the rotors turn at hover speed.",
            Rows(INITIAL, Vec::new()),
        ),
        (
            "ground",
            "The ground, a plane at flight.ground_z_m.",
            Rows(GroundSection::SETTINGS, Vec::new()),
        ),
        (
            "trajectory",
            "How the trajectory is stretched, and how its file is read.",
            Rows(TrajectorySection::SETTINGS, Vec::new()),
        ),
        (
            "plant",
            "The true airframe at tick 0. `ironbird inject` changes it in flight; noise, bias and delay of 0 mean none.",
            Rows(
                PlantSection::SETTINGS,
                SPECS.iter().map(|spec| spec.parameter).collect(),
            ),
        ),
        (
            "model",
            "The airframe as the laws know it. Changes in flight do not affect it. I_R, k_r and delta are not included: the \
             inner law `adaptive` estimates them.",
            Rows(&[], MODEL.to_vec()),
        ),
        (
            "rotor",
            "Range of the rotor speeds.",
            Rows(ROTOR, Vec::new()),
        ),
        (
            "rt",
            "Real-time execution and redundant channels.",
            Rows(RealtimeSection::SETTINGS, Vec::new()),
        ),
        (
            "simplex",
            "When a channel that flies other laws takes over.",
            Rows(SimplexSection::SETTINGS, Vec::new()),
        ),
        (
            "recorder",
            "The recorder. Gates: exit code 3 if one fails or measured nothing; a negative value switches a gate off.",
            Rows(RecorderSettings::SETTINGS, Vec::new()),
        ),
    ]
});

/// All settings except airframe parameters and laws' own.
pub fn settings() -> impl Iterator<Item = &'static Setting> {
    SECTIONS
        .iter()
        .flat_map(|(_, _, Rows(settings, _))| *settings)
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
pub static DEFAULT: LazyLock<String> = LazyLock::new(|| {
    let mut text = "# Settings of ironbird. Every key is optional and has the default shown here. Relative paths start at \
                    the folder of their file.\n"
        .to_owned();
    for (section, about, Rows(settings, parameters)) in SECTIONS.iter() {
        text += "\n";
        comment(&mut text, about);
        let _ = writeln!(text, "[{section}]");
        for setting in *settings {
            comment(&mut text, &with_allowed(setting));
            let _ = writeln!(text, "{} = {}", setting.key, setting.default);
        }
        for spec in parameters.iter().map(|parameter| parameter.spec()) {
            let (unit, name) = (after_blank(spec.unit), spec.name);
            let meaning = spec.meaning;
            let _ = writeln!(text, "{name} = {:?} # {meaning}{unit}", spec.nominal);
        }
    }
    text
});

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
    for (section, about, Rows(settings, parameters)) in SECTIONS.iter() {
        let _ = write!(page, "\n## [{section}]\n\n{about}\n\n");
        if !settings.is_empty() {
            page += "| key | default | allowed | flag | meaning |\n|---|---|---|---|---|\n";
        }
        for setting in *settings {
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
        if !settings.is_empty() && !parameters.is_empty() {
            page += "\n";
        }
        if !parameters.is_empty() {
            page += "| key | default | unit | range | meaning |\n|---|---|---|---|---|\n";
        }
        for spec in parameters.iter().map(|parameter| parameter.spec()) {
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
