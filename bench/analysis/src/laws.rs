//! The control laws of a flight: their signals, and outputs that could not be used.

use crate::schema::{LawSection, SignalSection};
use messages::content::{Mode, Wrench};
use messages::parameters::{ESTIMATED, Parameter};
use messages::role::Role;
use messages::telemetry::{LAW_ROLES, RATE_ERROR, Signal, Signals, TELEMETRY, Telemetry};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlownLaws {
    pub signals: Signals,
    /// The inner law, where it has no theorem with its settings, and so no estimates.
    pub without_theorem: Option<&'static str>,
}

/// Where what a law shows of a vector stands in its telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Places([usize; 3]);

impl Places {
    pub fn of(&self, wrench: &Wrench) -> [f64; 3] {
        self.0.map(|place| wrench.telemetry.value[place])
    }
}

impl FlownLaws {
    /// Where the rate error of the inner law is [rad/s]; none where it shows none.
    pub fn rate_error(&self) -> Option<Places> {
        self.signals.places(Role::Inner, RATE_ERROR).map(Places)
    }

    /// Where its estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2] are; none where it estimates nothing.
    pub fn estimates(&self) -> Option<Places> {
        let names = ESTIMATED.map(Parameter::name);
        let places = self.signals.places(Role::Inner, names);
        places
            .filter(|_| self.without_theorem.is_none())
            .map(Places)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NotFinite {
    ticks: u64,
    first: Option<u64>,
}

impl NotFinite {
    pub fn take(&mut self, tick: u64, mode: u64) {
        if mode == Mode::NotFinite as u64 {
            self.ticks += 1;
            self.first.get_or_insert(tick);
        }
    }

    pub fn section(self, name: &str, telemetry: Vec<SignalSection>) -> LawSection {
        LawSection {
            name: name.into(),
            ticks_not_finite: self.ticks,
            first_not_finite: self.first,
            telemetry,
            ..LawSection::default()
        }
    }
}

impl LawSection {
    pub fn file_name(&self) -> Option<&str> {
        self.file.as_deref()?.rsplit('/').next()
    }
}

pub fn in_order(
    laws: &BTreeMap<String, LawSection>,
) -> impl Iterator<Item = (&'static str, &LawSection)> {
    LAW_ROLES
        .into_iter()
        .filter_map(|role| Some((role.name(), laws.get(role.name())?)))
}

#[derive(Clone, Copy, Debug)]
pub struct SignalStatistics {
    signals: &'static [Signal],
    /// Newest, smallest and largest value of each; NaN of one that is not known.
    seen: [[f64; 3]; TELEMETRY],
}

impl SignalStatistics {
    pub const fn new(signals: &'static [Signal]) -> Self {
        Self {
            signals,
            seen: [[f64::NAN; 3]; TELEMETRY],
        }
    }

    /// Takes what it shows of a tick: numbers alone.
    pub fn take(&mut self, telemetry: &Telemetry) {
        for ([last, min, max], (_, value)) in self.seen.iter_mut().zip(telemetry.of(self.signals)) {
            if value.is_finite() {
                (*last, *min, *max) = (value, min.min(value), max.max(value));
            }
        }
    }

    pub fn section(&self) -> Vec<SignalSection> {
        let section = |(signal, [last, min, max]): (&Signal, [f64; 3])| SignalSection {
            name: signal.name.into(),
            unit: signal.unit.into(),
            last: Some(last).filter(|it| it.is_finite()),
            min: Some(min).filter(|it| it.is_finite()),
            max: Some(max).filter(|it| it.is_finite()),
        };
        self.signals.iter().zip(self.seen).map(section).collect()
    }
}
