//! Compares replayed messages with the recorded ones, bit for bit.

use std::fmt;

use model::role::Role;
use model::telemetry::{Signals, TELEMETRY, Telemetry};
use model::topic::Topic;

use flight_log::codec::Logged;
use flight_log::rows::{named, words};
use flight_log::telemetry::topic;

/// A value that came out differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// At which tick.
    pub tick: u64,
    /// Whose output.
    pub stage: Role,
    /// On which topic.
    pub topic: &'static str,
    /// Which field.
    pub field: String,
    /// What the log says.
    pub recorded: String,
    /// What came out now.
    pub replayed: String,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tick, stage, topic, field, recorded, replayed } = self;
        write!(f, "tick {tick}, stage {stage}: {topic}.{field} was {recorded}, replayed {replayed}")
    }
}

/// Compares from a tick on, and remembers the first difference.
#[derive(Clone, Debug, Default)]
pub struct ReplayComparison {
    from_tick: u64,
    /// What the laws show.
    signals: Signals,
    /// Values compared.
    pub values: u64,
    /// The first difference.
    pub first: Option<Divergence>,
}

impl ReplayComparison {
    /// Compares nothing before a tick, in a flight whose laws show this.
    #[must_use]
    pub fn from(from_tick: u64, signals: Signals) -> Self {
        Self { from_tick, signals, ..Self::default() }
    }

    /// Compares a content of a tick.
    pub fn compare<C: Logged>(&mut self, tick: u64, recorded: &C, replayed: &C) {
        if tick < self.from_tick {
            return;
        }
        if recorded.is_same(replayed) {
            let no_signals = recorded.telemetry().map_or(0, |_| TELEMETRY - self.signals.of(C::SENDER).len());
            self.values += (size_of::<C>() / size_of::<u64>() - no_signals) as u64;
            return;
        }
        match words(recorded).iter().zip(&words(replayed)).position(|(a, b)| a != b) {
            Some(place) => {
                let name = |content: &C| named(content).into_iter().nth(place).unwrap_or_default();
                let ((field, recorded), (_, replayed)) = (name(recorded), name(replayed));
                self.differ::<C>(tick, field, recorded, replayed);
            }
            // All else is the same.
            None => self.differ_shown::<C>(tick, recorded.telemetry(), replayed.telemetry()),
        }
    }

    /// Takes a difference in what a law shows down, if it is the first.
    fn differ_shown<C: Logged>(&mut self, tick: u64, recorded: Option<&Telemetry>, replayed: Option<&Telemetry>) {
        let (Some(recorded), Some(replayed), Some(topic)) = (recorded, replayed, topic(C::SENDER)) else { return };
        let differs = |place: &usize| recorded.value[*place].to_bits() != replayed.value[*place].to_bits();
        let Some(place) = (0..TELEMETRY).find(differs) else { return };
        // The law of another build may have shown more than is known here.
        let signal = self.signals.of(C::SENDER).get(place);
        let field = signal.map_or_else(|| format!("value[{place}]"), |signal| signal.name.to_owned());
        let [recorded, replayed] = [recorded, replayed].map(|shown| format!("{:?}", shown.value[place]));
        self.first.get_or_insert(Divergence { tick, stage: C::SENDER, topic, field, recorded, replayed });
    }

    /// Takes a difference down, if it is the first.
    pub fn differ<C: Logged>(&mut self, tick: u64, field: String, recorded: String, replayed: String) {
        if tick >= self.from_tick {
            let (stage, topic) = (C::SENDER, <C as Topic>::NAME);
            self.first.get_or_insert(Divergence { tick, stage, topic, field, recorded, replayed });
        }
    }
}

#[cfg(test)]
mod tests {
    use model::messages::Wrench;
    use model::telemetry::Signal;

    use super::*;

    #[test]
    fn every_number_that_a_law_showed_is_compared_whatever_is_known_of_its_signals() {
        const SIGNALS: &[Signal] = &[Signal { name: "mass_kg", unit: "kg" }];
        for (place, said) in [(0, "mass_kg was 0.5"), (1, "value[1] was 0.5"), (31, "value[31] was 0.5")] {
            let mut comparison = ReplayComparison::from(3, Signals { inner: SIGNALS, ..Signals::default() });
            let (mut recorded, replayed) = (Wrench::default(), Wrench::default());
            recorded.telemetry.value[place] = 0.5;
            comparison.compare(2, &recorded, &replayed);
            assert_eq!((comparison.first.as_ref(), comparison.values), (None, 0), "before the first tick that counts");
            comparison.compare(4, &recorded, &replayed);
            let said = format!("tick 4, stage inner: inner_telemetry.{said}, replayed 0.0");
            assert_eq!(comparison.first.map(|first| first.to_string()), Some(said));
        }
    }
}
