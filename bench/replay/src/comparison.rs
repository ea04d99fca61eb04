//! Compares replayed messages with the recorded ones, bit for bit.

use std::fmt;

use messages::role::{Channel, Replica};
use messages::telemetry::{Signals, TELEMETRY, Telemetry};

use flight_log::codec::Logged;
use flight_log::rows::{named, words};
use flight_log::telemetry::topic;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    pub tick: u64,
    pub stage: Replica,
    pub topic: &'static str,
    pub field: String,
    pub recorded: String,
    pub replayed: String,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "tick {}, stage {}: {}.{} was {}, replayed {}",
            self.tick, self.stage, self.topic, self.field, self.recorded, self.replayed
        )
    }
}

/// Compares from a tick on and keeps the first difference.
#[derive(Clone, Debug)]
pub struct ReplayComparison {
    from_tick: u64,
    channel: Channel,
    signals: Signals,
    pub values: u64,
    /// Messages of another program, which are not compared.
    pub foreign: u64,
    pub first: Option<Divergence>,
}

impl ReplayComparison {
    pub fn from(from_tick: u64, channel: Channel, signals: Signals) -> Self {
        Self {
            from_tick,
            channel,
            signals,
            values: 0,
            foreign: 0,
            first: None,
        }
    }

    /// Adds what was compared in another log; of two differences in a tick, this one's stays the first.
    pub fn add(&mut self, other: Self) {
        self.values += other.values;
        self.foreign += other.foreign;
        let both = [self.first.take(), other.first].into_iter().flatten();
        self.first = both.min_by_key(|it| it.tick);
    }

    pub fn compare<C: Logged>(&mut self, tick: u64, recorded: &C, replayed: &C) {
        if tick < self.from_tick {
            return;
        }
        if recorded.is_same(replayed) {
            let no_signals = recorded
                .telemetry()
                .map_or(0, |_| TELEMETRY - self.signals.of(C::SENDER).len());
            self.values += (size_of::<C>() / size_of::<u64>() - no_signals) as u64;
            return;
        }
        let mut pairs = words(recorded).into_iter().zip(words(replayed));
        match pairs.position(|(recorded, replayed)| recorded != replayed) {
            Some(place) => {
                let name = |content: &C| named(content).into_iter().nth(place).unwrap_or_default();
                let ((field, recorded), (_, replayed)) = (name(recorded), name(replayed));
                self.keep::<C>(tick, C::NAME, [field, recorded, replayed]);
            }
            // All else is the same.
            None => self.compare_telemetry::<C>(tick, recorded.telemetry(), replayed.telemetry()),
        }
    }

    fn compare_telemetry<C: Logged>(
        &mut self,
        tick: u64,
        recorded: Option<&Telemetry>,
        replayed: Option<&Telemetry>,
    ) {
        let (Some(recorded), Some(replayed), Some(topic)) = (recorded, replayed, topic(C::SENDER))
        else {
            return;
        };
        let differs =
            |place: &usize| recorded.value[*place].to_bits() != replayed.value[*place].to_bits();
        let Some(place) = (0..TELEMETRY).find(differs) else {
            return;
        };
        // The law of another build may have signals that are not known here.
        let signal = self.signals.of(C::SENDER).get(place);
        let field = signal.map_or_else(|| format!("value[{place}]"), |it| it.name.to_owned());
        let [recorded, replayed] =
            [recorded, replayed].map(|telemetry| format!("{:?}", telemetry.value[place]));
        self.keep::<C>(tick, topic, [field, recorded, replayed]);
    }

    /// A message was recorded, and the replay has none; `field` is its first one.
    pub fn lacks<C: Logged>(&mut self, tick: u64, field: &str) {
        self.differs::<C>(tick, field, ["published", "nothing"].map(str::to_owned));
    }

    /// A field of a message differs.
    pub fn differs<C: Logged>(
        &mut self,
        tick: u64,
        field: &str,
        [recorded, replayed]: [String; 2],
    ) {
        if tick >= self.from_tick {
            self.keep::<C>(tick, C::NAME, [field.to_owned(), recorded, replayed]);
        }
    }

    /// Keeps a difference if it is the first.
    fn keep<C: Logged>(
        &mut self,
        tick: u64,
        topic: &'static str,
        [field, recorded, replayed]: [String; 3],
    ) {
        self.first.get_or_insert(Divergence {
            tick,
            stage: Replica::new(C::SENDER, self.channel),
            topic,
            field,
            recorded,
            replayed,
        });
    }
}

#[cfg(test)]
mod tests {
    use messages::content::Wrench;
    use messages::telemetry::Signal;

    use super::*;

    #[test]
    fn every_number_that_a_law_showed_is_compared_whatever_is_known_of_its_signals() {
        const INNER: &[Signal] = &[Signal {
            name: "mass_kg",
            unit: "kg",
        }];
        for (place, said) in [
            (0, "mass_kg was 0.5"),
            (1, "value[1] was 0.5"),
            (31, "value[31] was 0.5"),
        ] {
            let signals = Signals {
                inner: INNER,
                ..Signals::default()
            };
            let mut comparison = ReplayComparison::from(3, Channel::A, signals);
            let (mut recorded, replayed) = (Wrench::default(), Wrench::default());
            recorded.telemetry.value[place] = 0.5;
            comparison.compare(2, &recorded, &replayed);
            assert!(
                comparison.first.is_none() && comparison.values == 0,
                "too early"
            );
            comparison.compare(4, &recorded, &replayed);
            let said = format!("tick 4, stage inner: inner_telemetry.{said}, replayed 0.0");
            assert_eq!(comparison.first.map(|first| first.to_string()), Some(said));
        }
    }
}
