//! Parses the values of flags. An error says what is allowed.

use std::ffi::OsStr;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command};
use config::law_settings::preset_names;
use config::overrides;
use config::trajectory::is_file;
use control_api::PERIODS_S;
use controller::Trajectory;
pub(crate) use faults::grammar::duration;
use faults::grammar::{Fault, FaultError};
use messages::role::Channel;
use toml::Value;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberOrAuto {
    /// From a measurement before take-off.
    Auto,
    Number(u32),
}

impl NumberOrAuto {
    pub fn number(self) -> Option<i64> {
        match self {
            Self::Auto => None,
            Self::Number(number) => Some(number.into()),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Counted from 1; none if the job's environment gives it.
    pub number: Option<u64>,
    pub of: u64,
}

pub(crate) fn tick(text: &str) -> Result<u64, String> {
    // The largest number stands for no tick.
    let tick = text.parse().ok().filter(|tick| *tick != u64::MAX);
    tick.ok_or_else(|| "write the number of a tick, from 0 on, as in 8000".into())
}

/// One of some names, which shells complete, or another text that `takes` allows.
#[derive(Clone)]
pub(crate) struct NameOr {
    names: fn() -> Vec<&'static str>,
    takes: fn(&str) -> bool,
}

/// A built-in trajectory, or a file of points.
pub(crate) const TRAJECTORY: NameOr = NameOr {
    names: || Trajectory::ALL.map(Trajectory::name).to_vec(),
    takes: is_file,
};

/// A preset: those of the laws that are built in are known, those of files are looked for later.
pub(crate) const PRESET: NameOr = NameOr {
    names: preset_names,
    takes: |name| !name.is_empty(),
};

impl TypedValueParser for NameOr {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        match value.to_str().filter(|text| (self.takes)(text)) {
            Some(text) => Ok(text.into()),
            None => PossibleValuesParser::new((self.names)()).parse_ref(command, arg, value),
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new((self.names)().into_iter().map(PossibleValue::new)))
    }
}

/// A channel by its letter.
pub(crate) fn channel(text: &str) -> Result<Channel, String> {
    let channel = Channel::ALL.into_iter().find(|it| it.name() == text);
    channel.ok_or_else(|| "the channels are a, b and c".into())
}

pub(crate) fn processor(text: &str) -> Result<u16, String> {
    text.parse().map_err(|_| {
        "no processor has this number; write 0, 1 and so on, or leave the flag out: the highest-numbered one is taken"
            .into()
    })
}

pub(crate) fn number_or_auto(text: &str) -> Result<NumberOrAuto, String> {
    match text {
        "auto" => Ok(NumberOrAuto::Auto),
        number => number
            .parse()
            .map(NumberOrAuto::Number)
            .map_err(|_| "write a whole number, or auto".into()),
    }
}

/// The period of a rate in Hz, or in kHz as in 4k [s].
pub(crate) fn period_s(text: &str) -> Result<f64, String> {
    let (number, factor) = match text.strip_suffix('k') {
        Some(number) => (number, 1e3),
        None => (text, 1.0),
    };
    let hz = number
        .parse()
        .map_or(f64::NAN, |number: f64| number * factor);
    let period_ns = 1e9 / hz;
    if !PERIODS_S.contains(&(period_ns / 1e9)) {
        let [least_hz, most_hz] =
            [PERIODS_S.end(), PERIODS_S.start()].map(|period_s| 1.0 / period_s);
        return Err(format!(
            "write a rate from {least_hz} to {most_hz} Hz, as in 500 or 4k"
        ));
    }
    if period_ns.fract() != 0.0 {
        return Err(format!(
            "its period of {period_ns:.3} ns is not a whole number of nanoseconds; choose a rate that divides 10^9 Hz, \
             as in 2500 or 4k, or write flight.period_s in a settings file"
        ));
    }
    Ok(period_ns / 1e9)
}

/// A setting by its key.
pub(crate) fn setting(text: &str) -> Result<(&'static str, Value), String> {
    overrides::set("--set", text)
}

pub(crate) fn limit(text: &str) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| "write a number of 0 or more, as in 100 or 2.5".into())
}

/// A share [%].
pub(crate) fn percent(text: &str) -> Result<f64, String> {
    let percent = limit(text).ok().filter(|percent| *percent <= 100.0);
    percent.ok_or_else(|| "write a number from 0 to 100, as in 95 or 99.9".into())
}

/// A whole number of a range.
pub(crate) fn within<T: FromStr + PartialOrd + Display + Clone>(
    range: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text: &str| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let (least, most) = (range.start(), range.end());
        number.ok_or_else(|| format!("write a whole number from {least} to {most}"))
    }
}

/// A number of ticks of which one is taken.
pub(crate) fn every(text: &str) -> Result<u32, String> {
    within(1..=1_000_000_000)(text)
}

pub(crate) fn shards(text: &str) -> Result<u64, String> {
    within(1..=1_000_000)(text)
}

/// A number of flights at once.
pub(crate) fn jobs(text: &str) -> Result<usize, String> {
    within(1..=4096)(text)
}

/// A part of a campaign, as K/N or auto/N.
pub(crate) fn shard(text: &str) -> Result<Shard, String> {
    let read = || {
        let (number, of) = text.split_once('/')?;
        let of = shards(of).ok()?;
        let number = match number {
            "auto" => None,
            number => Some(within(1..=of)(number).ok()?),
        };
        Some(Shard { number, of })
    };
    read().ok_or_else(|| "write K/N with K from 1 to N, as in 3/24, or auto/24".to_owned())
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
