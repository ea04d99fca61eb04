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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_without_numbers_is_counted_and_named() {
        let mut inner = NotFinite::default();
        for (tick, mode) in [
            (3, Mode::Fresh),
            (4, Mode::NotFinite),
            (5, Mode::Held),
            (9, Mode::NotFinite),
        ] {
            inner.take(tick, mode as u64);
        }
        let section = inner.section("x", Vec::new());
        assert_eq!(
            (section.ticks_not_finite, section.first_not_finite),
            (2, Some(4))
        );
        let outer = NotFinite::default().section("pd", Vec::new());
        assert_eq!(outer.first_not_finite, None);
    }

    const SIGNALS: [Signal; 3] = {
        const fn signal(name: &'static str, unit: &'static str) -> Signal {
            Signal { name, unit }
        }
        [
            signal("mass_kg", "kg"),
            signal("limited", ""),
            signal("never", ""),
        ]
    };

    #[test]
    fn what_was_not_known_is_no_number_of_the_flight() {
        let mut statistics = SignalStatistics::new(&SIGNALS);
        for mass_kg in [0.5, 0.7, 0.6] {
            let mut telemetry = Telemetry::unknown(3);
            telemetry.value[..2].copy_from_slice(&[mass_kg, 1.0]);
            statistics.take(&telemetry);
        }
        statistics.take(&Telemetry::unknown(3));
        let section = statistics.section();
        let numbers = section
            .iter()
            .map(|signal| [signal.last, signal.min, signal.max]);
        let expected = [[Some(0.6), Some(0.5), Some(0.7)], [Some(1.0); 3], [None; 3]];
        assert!(numbers.eq(expected), "{section:?}");
        assert_eq!((&*section[0].name, &*section[0].unit), ("mass_kg", "kg"));
    }
}
