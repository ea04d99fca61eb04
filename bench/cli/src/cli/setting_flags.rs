//! The flags that set settings, made from the declarations of the settings.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::Error;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use config::declarations::{Allowed, Flag, Group, Notation, Setting, settings};
use config::law_settings::preset_names;
use config::trajectory::is_file;
use config::{Overrides, PaceName, Settings, overrides};
use controller::Trajectory;
use errors::Failure;
use toml::Value;

use crate::cli::values;

/// The flags of a group that were given, as overrides of their settings.
#[derive(Clone, Debug, Default)]
pub struct SettingFlags<const GROUP: u8>(Overrides);

pub const FLIGHT: u8 = Group::Flight as u8;
pub const REAL_TIME: u8 = Group::RealTime as u8;
pub const RECORD: u8 = Group::Record as u8;
pub const STATES: u8 = Group::States as u8;
pub const TIMING_GATES: u8 = Group::TimingGates as u8;
pub const FLIGHT_GATES: u8 = Group::FlightGates as u8;
pub const CHANNELS: u8 = Group::Channels as u8;

impl<const GROUP: u8> SettingFlags<GROUP> {
    pub fn overrides(&self) -> Overrides {
        self.0.clone()
    }

    fn declared() -> impl Iterator<Item = (&'static Setting, Flag)> {
        settings().filter_map(|setting| {
            let flag = setting.flag.filter(|flag| flag.group as u8 == GROUP);
            Some((setting, flag?))
        })
    }
}

/// Refuses flags that need the clock in a lockstep flight: those among the overrides, `--set` of the same settings, and
/// others, each with whether it is given.
pub fn check_clock_flags(
    settings: &Settings,
    given: &Overrides,
    others: &[(&str, bool)],
) -> Result<(), Failure> {
    let needs_clock = |(typed, value): &(&'static str, Value)| {
        let (set, path) = overrides::parts(typed);
        let setting = config::declarations::settings().find(|setting| setting.path == path);
        let flag = setting.and_then(|setting| setting.flag);
        let flag = flag.filter(|flag| flag.needs_clock && value.as_str() != Some("off"));
        flag.map(|flag| set.map_or(flag.name, |_| *typed))
    };
    let other = others.iter().find(|(_, is_given)| *is_given);
    let flag = given
        .iter()
        .find_map(needs_clock)
        .or(other.map(|(flag, _)| *flag));
    match (settings.flight.pace, flag) {
        (PaceName::Lockstep, Some(flag)) => Err(Failure::usage(format!(
            "{flag} has no meaning in lockstep, where no clock moves the ticks"
        ))
        .help(format!(
            "remove {flag}, or fly in real time: --pace realtime"
        ))),
        _ => Ok(()),
    }
}

impl<const GROUP: u8> Args for SettingFlags<GROUP> {
    fn augment_args(command: Command) -> Command {
        command.args(Self::declared().map(|(setting, flag)| arg(setting, flag)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const GROUP: u8> FromArgMatches for SettingFlags<GROUP> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let value = |(setting, flag): (&'static Setting, Flag)| {
            let value = match flag.notation {
                Notation::Switch => matches.get_flag(setting.path).then_some(Value::from(true)),
                _ => matches.get_one::<Value>(setting.path).cloned(),
            };
            Some((setting.path, value?))
        };
        Ok(Self(Self::declared().filter_map(value).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn arg(setting: &'static Setting, flag: Flag) -> Arg {
    let (short, long) = setting.explanations();
    let default = flag.default.unwrap_or(setting.default).trim_matches('"');
    let default = match default {
        "" | "false" => String::new(),
        default => format!("default: {default}"),
    };
    let allowed = match setting.allowed {
        Allowed::Range(..) => format!("{}; ", setting.allowed_text()),
        _ => String::new(),
    };
    let with_default = |text: &str| match allowed.clone() + &default {
        facts if facts.is_empty() => text.trim_end_matches('.').to_owned(),
        facts => format!("{} [{facts}]", text.trim_end_matches('.')),
    };
    let short_help = with_default(flag.help.unwrap_or(&short));
    let arg = Arg::new(setting.path)
        .long(&flag.name[2..])
        .help(short_help.clone());
    let arg = match long.split_once("\n\n") {
        Some((_, rest)) => arg.long_help(format!("{short_help}\n\n{rest}")),
        None => arg,
    };
    match flag.notation {
        Notation::Switch => arg.action(ArgAction::SetTrue),
        _ => arg
            .value_name(flag.value)
            .allow_hyphen_values(true)
            .value_parser(SettingParser { setting, flag }),
    }
}

/// Reads the value of a flag as its notation says.
#[derive(Clone, Copy)]
struct SettingParser {
    setting: &'static Setting,
    flag: Flag,
}

impl SettingParser {
    /// The words of which one is expected, and which shells complete.
    fn words(&self) -> Option<Vec<PossibleValue>> {
        let plain = |names: &[&'static str]| names.iter().map(PossibleValue::new).collect();
        match (self.flag.notation, self.setting.allowed) {
            (Notation::Trajectory, _) => Some(plain(&Trajectory::ALL.map(Trajectory::name))),
            (Notation::Preset, _) => Some(plain(&preset_names())),
            (Notation::Plain, Allowed::OneOf(words)) => {
                let word = |(word, meaning): &(&'static str, &'static str)| {
                    PossibleValue::new(*word).help(*meaning)
                };
                Some(words.iter().map(word).collect())
            }
            (Notation::Plain, _) if is_bool(self.setting) => Some(plain(&["true", "false"])),
            _ => None,
        }
    }

    /// Whether a value that is none of the words is allowed, too.
    fn is_other(&self, text: &str) -> bool {
        match self.flag.notation {
            Notation::Trajectory => is_file(text),
            // Presets of laws from files are looked for later.
            Notation::Preset => !text.is_empty(),
            _ => false,
        }
    }

    fn read(&self, text: &str) -> Result<Value, String> {
        let whole = |range| values::within::<i64>(range)(text).map(Value::from);
        match self.flag.notation {
            Notation::Duration => values::duration(text).map(|it| Value::from(it.as_secs_f64())),
            Notation::Rate => values::period_s(text).map(Value::from),
            Notation::Processor => values::processor(text).map(|it| Value::from(i64::from(it))),
            Notation::WholeOrAuto if text == "auto" => Ok(Value::from(text)),
            Notation::WholeOrAuto => text
                .parse::<u32>()
                .map(|number| Value::from(i64::from(number)))
                .map_err(|_| "write a whole number, or auto".into()),
            Notation::Plain | Notation::Switch | Notation::Trajectory | Notation::Preset => {
                match self.setting.allowed {
                    Allowed::Limit | Allowed::Share => values::limit(text).map(Value::from),
                    Allowed::Range(min, max) if is_whole(self.setting) => {
                        whole(min as i64..=max as i64)
                    }
                    Allowed::Range(min, max) => values::number(min..=max)(text).map(Value::from),
                    Allowed::Counts(_) => text
                        .parse::<i64>()
                        .map(Value::from)
                        .map_err(|_| format!("write one of {}", self.setting.allowed_text())),
                    _ if is_whole(self.setting) => whole(0..=i64::MAX),
                    _ if self.setting.default.starts_with('"') => Ok(Value::from(text)),
                    // Of a wrong type, it is refused with the example of the default.
                    _ => overrides::as_in_a_file(text),
                }
            }
        }
    }
}

fn is_whole(setting: &Setting) -> bool {
    setting.default.parse::<i64>().is_ok()
}

fn is_bool(setting: &Setting) -> bool {
    setting.default.parse::<bool>().is_ok()
}

impl TypedValueParser for SettingParser {
    type Value = Value;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> Result<Value, Error> {
        let is_other = value.to_str().is_none_or(|text| self.is_other(text));
        if let Some(words) = self.words().filter(|_| !is_other) {
            PossibleValuesParser::new(words).parse_ref(command, arg, value)?;
        }
        let parser = *self;
        let read = move |text: &str| parser.read(text);
        read.parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.words()?.into_iter()))
    }
}
