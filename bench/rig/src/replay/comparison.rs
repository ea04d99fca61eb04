//! Compares replayed messages with the recorded ones, bit for bit.

use std::fmt;

use messages::role::Role;
use messages::telemetry::{Signals, TELEMETRY, Telemetry};
use messages::topic::Topic;

use flight_log::codec::Logged;
use flight_log::rows::{named, words};
use flight_log::telemetry::topic;

/// The first value that differs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    pub tick: u64,
    pub stage: Role,
    pub topic: &'static str,
    pub field: String,
    pub recorded: String,
    pub replayed: String,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            tick,
            stage,
            topic,
            field,
            recorded,
            replayed,
        } = self;
        write!(
            f,
            "tick {tick}, stage {stage}: {topic}.{field} was {recorded}, replayed {replayed}"
        )
    }
}

/// Compares from a tick on and keeps the first difference.
#[derive(Clone, Debug, Default)]
pub struct ReplayComparison {
    from_tick: u64,
    signals: Signals,
    pub values: u64,
    pub first: Option<Divergence>,
}

impl ReplayComparison {
    #[must_use]
    pub fn from(from_tick: u64, signals: Signals) -> Self {
        Self {
            from_tick,
            signals,
            ..Self::default()
        }
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
        match words(recorded)
            .iter()
            .zip(&words(replayed))
            .position(|(a, b)| a != b)
        {
            Some(place) => {
                let name = |content: &C| named(content).into_iter().nth(place).unwrap_or_default();
                let ((field, recorded), (_, replayed)) = (name(recorded), name(replayed));
                self.differ::<C>(tick, field, recorded, replayed);
            }
            // All else is the same.
            None => self.differ_shown::<C>(tick, recorded.telemetry(), replayed.telemetry()),
        }
    }

    /// Keeps a difference in telemetry if it is the first.
    fn differ_shown<C: Logged>(
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
        // The law of another build may have shown more than is known here.
        let signal = self.signals.of(C::SENDER).get(place);
        let field = signal.map_or_else(
            || format!("value[{place}]"),
            |signal| signal.name.to_owned(),
        );
        let [recorded, replayed] =
            [recorded, replayed].map(|shown| format!("{:?}", shown.value[place]));
        self.first.get_or_insert(Divergence {
            tick,
            stage: C::SENDER,
            topic,
            field,
            recorded,
            replayed,
        });
    }

    /// Keeps a difference if it is the first.
    pub fn differ<C: Logged>(
        &mut self,
        tick: u64,
        field: String,
        recorded: String,
        replayed: String,
    ) {
        if tick >= self.from_tick {
            let (stage, topic) = (C::SENDER, <C as Topic>::NAME);
            self.first.get_or_insert(Divergence {
                tick,
                stage,
                topic,
                field,
                recorded,
                replayed,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use messages::content::Wrench;
    use messages::telemetry::Signal;

    use super::*;

    #[test]
    fn every_number_that_a_law_showed_is_compared_whatever_is_known_of_its_signals() {
        const SIGNALS: &[Signal] = &[Signal {
            name: "mass_kg",
            unit: "kg",
        }];
        for (place, said) in [
            (0, "mass_kg was 0.5"),
            (1, "value[1] was 0.5"),
            (31, "value[31] was 0.5"),
        ] {
            let mut comparison = ReplayComparison::from(
                3,
                Signals {
                    inner: SIGNALS,
                    ..Signals::default()
                },
            );
            let (mut recorded, replayed) = (Wrench::default(), Wrench::default());
            recorded.telemetry.value[place] = 0.5;
            comparison.compare(2, &recorded, &replayed);
            assert_eq!(
                (comparison.first.as_ref(), comparison.values),
                (None, 0),
                "before the first tick that counts"
            );
            comparison.compare(4, &recorded, &replayed);
            let said = format!("tick 4, stage inner: inner_telemetry.{said}, replayed 0.0");
            assert_eq!(comparison.first.map(|first| first.to_string()), Some(said));
        }
    }
}
