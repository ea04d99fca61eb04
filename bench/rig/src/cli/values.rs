//! Parses the values of flags. An error says what is allowed.

use std::ffi::OsStr;
use std::time::Duration;

use crate::cli::{LeadArg, Shard};
use crate::fault::{Fault, FaultError};
use crate::settings::law_settings::preset_names;
use crate::settings::trajectory::is_file;
use clap::builder::{
    NonEmptyStringValueParser, PossibleValue, PossibleValuesParser, TypedValueParser,
};
use clap::{Arg, Command};
use controller::Trajectory;

/// A length of time with its unit.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    const WRITE: &str = "write a number of 0 or more and its unit, as in 500ms, 30s or 2m";
    humantime::parse_duration(text).map_err(|e| {
        let why = if text.starts_with('-') {
            "a time is not negative".into()
        } else {
            e.to_string()
        };
        format!("{}; {WRITE}", why.trim_end())
    })
}

pub(crate) fn tick(text: &str) -> Result<u64, String> {
    // The largest number stands for no tick.
    let tick = text.parse().ok().filter(|tick| *tick != u64::MAX);
    tick.ok_or_else(|| {
        "write the number of a tick, from 0 on, as in 8000; --in takes a time".into()
    })
}

/// A built-in trajectory, or a file of points.
#[derive(Clone)]
pub(crate) struct TrajectoryParser;

impl TypedValueParser for TrajectoryParser {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        match value.to_str().filter(|text| is_file(text)) {
            Some(file) => Ok(file.into()),
            None => PossibleValuesParser::new(Trajectory::NAMES).parse_ref(command, arg, value),
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(
            Trajectory::NAMES.into_iter().map(PossibleValue::new),
        ))
    }
}

/// The name of a preset: those of the laws that are built in are known, those of files are looked for later.
#[derive(Clone)]
pub(crate) struct PresetParser;

impl TypedValueParser for PresetParser {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        NonEmptyStringValueParser::new().parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(preset_names().into_iter().map(PossibleValue::new)))
    }
}

pub(crate) fn processor(text: &str) -> Result<u16, String> {
    text.parse().map_err(|_| {
        "no processor has this number; write 0, 1 and so on, or leave the flag out: the highest-numbered one is taken"
            .into()
    })
}

/// How far ahead of its tick a timer is set.
pub(crate) fn lead(text: &str) -> Result<LeadArg, String> {
    match text {
        "auto" => Ok(LeadArg::Auto),
        us => us
            .parse()
            .map(LeadArg::Us)
            .map_err(|_| "write whole microseconds, as in 150, or auto".into()),
    }
}

pub(crate) fn limit(text: &str) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| "write a number of 0 or more, as in 100 or 2.5".into())
}

/// A seed, as a settings file can have it.
pub(crate) fn seed(text: &str) -> Result<i64, String> {
    let number = text.parse().ok().filter(|number| *number >= 0);
    number.ok_or_else(|| format!("write a whole number from 0 to {}", i64::MAX))
}

/// A number of ticks of which one is taken.
pub(crate) fn every(text: &str) -> Result<u32, String> {
    const MOST: u32 = 1_000_000_000;
    let number = text
        .parse()
        .ok()
        .filter(|number| (1..=MOST).contains(number));
    number.ok_or_else(|| format!("write a whole number from 1 to {MOST}"))
}

/// A part of a campaign, as K/N or auto/N.
pub(crate) fn shard(text: &str) -> Result<Shard, String> {
    let wrong = || "write K/N with K from 1 to N, as in 3/24, or auto/24".to_owned();
    let (number, of) = text.split_once('/').ok_or_else(wrong)?;
    let of = of
        .parse()
        .ok()
        .filter(|of| (1..=1_000_000).contains(of))
        .ok_or_else(wrong)?;
    match number {
        "auto" => Ok(Shard { number: None, of }),
        number => {
            let number = number
                .parse()
                .ok()
                .filter(|number| (1..=of).contains(number))
                .ok_or_else(wrong)?;
            Ok(Shard {
                number: Some(number),
                of,
            })
        }
    }
}

pub(crate) fn shards(text: &str) -> Result<u64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number| (1..=1_000_000).contains(number));
    number.ok_or_else(|| "write a whole number from 1 to 1000000".into())
}

/// A number of flights at once.
pub(crate) fn jobs(text: &str) -> Result<usize, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number| (1..=4096).contains(number));
    number.ok_or_else(|| "write a whole number from 1 to 4096".into())
}

/// The origin of a page, as a browser tells it.
pub(crate) fn origin(text: &str) -> Result<String, String> {
    let is_origin = text.split_once("://").is_some_and(|(scheme, host)| {
        !scheme.is_empty()
            && !host.is_empty()
            && !host.contains(['/', '*'])
            && !text.contains(char::is_whitespace)
    });
    if is_origin {
        return Ok(text.to_owned());
    }
    Err("write scheme, host and port as the browser does, without a path, as in https://studio.example:8080".into())
}

pub(crate) fn fault(text: &str) -> Result<Fault, String> {
    text.parse()
        .map_err(|e: FaultError| format!("{e} ({})", e.listed("")))
}
