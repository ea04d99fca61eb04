//! Parses the values of flags. An error says what is allowed.

use std::fmt::Display;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::str::FromStr;

use config::overrides;
use control_api::PERIODS_S;
pub(crate) use faults::grammar::duration;
use faults::grammar::{Fault, FaultError};
use messages::role::Channel;
use toml::Value;

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

/// An address with its port.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "write an IP address and a port, as in 127.0.0.1:14550".into())
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
    in_range("a whole number", range)
}

/// A number of a range.
pub(crate) fn number(range: RangeInclusive<f64>) -> impl Fn(&str) -> Result<f64, String> + Clone {
    in_range("a number", range)
}

fn in_range<T: FromStr + PartialOrd + Display + Clone>(
    kind: &str,
    range: RangeInclusive<T>,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text: &str| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let (least, most) = (range.start(), range.end());
        number.ok_or_else(|| format!("write {kind} from {least} to {most}"))
    }
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
