//! What a law shows, as numbers of the whole flight: the newest, the smallest, the largest of each signal.

use model::telemetry::{Signal, TELEMETRY, Telemetry};

use crate::laws::SignalSection;

/// Follows the signals of a law.
#[derive(Clone, Copy, Debug)]
pub struct TelemetryTally {
    signals: &'static [Signal],
    /// Newest, smallest and largest value of each; NaN of one that is not known.
    seen: [[f64; 3]; TELEMETRY],
}

impl TelemetryTally {
    /// Of a law with these signals, before its first tick.
    #[must_use]
    pub const fn new(signals: &'static [Signal]) -> Self {
        Self { signals, seen: [[f64::NAN; 3]; TELEMETRY] }
    }

    /// Takes what it shows of a tick: numbers alone.
    pub fn take(&mut self, telemetry: &Telemetry) {
        for ([last, min, max], (_, value)) in self.seen.iter_mut().zip(telemetry.of(self.signals)) {
            if value.is_finite() {
                (*last, *min, *max) = (value, min.min(value), max.max(value));
            }
        }
    }

    /// The section of the report.
    #[must_use]
    pub fn section(&self) -> Vec<SignalSection> {
        let section = |(signal, [last, min, max]): (&Signal, [f64; 3])| SignalSection {
            name: signal.name.into(),
            unit: signal.unit.into(),
            last: known(last),
            min: known(min),
            max: known(max),
        };
        self.signals.iter().zip(self.seen).map(section).collect()
    }
}

fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGNALS: [Signal; 3] = [
        Signal { name: "mass_kg", unit: "kg" },
        Signal { name: "limited", unit: "" },
        Signal { name: "never", unit: "" },
    ];

    #[test]
    fn what_was_not_known_is_no_number_of_the_flight() {
        let mut tally = TelemetryTally::new(&SIGNALS);
        for mass_kg in [0.5, 0.7, 0.6] {
            let mut telemetry = Telemetry::unsaid(3);
            telemetry.value[..2].copy_from_slice(&[mass_kg, 1.0]);
            tally.take(&telemetry);
        }
        tally.take(&Telemetry::unsaid(3));
        let section = tally.section();
        let numbers: Vec<_> = section.iter().map(|signal| [signal.last, signal.min, signal.max]).collect();
        assert_eq!(numbers, [[Some(0.6), Some(0.5), Some(0.7)], [Some(1.0); 3], [None; 3]]);
        assert_eq!((section[0].name.as_str(), section[0].unit.as_str()), ("mass_kg", "kg"));
    }
}
