//! Compares measurements with their floors, pair by pair.
//!
//! Both sides of a pair are measured within the same minute. The interval of the ratio ([`analysis::statistics`]) says
//! how much the pairs tell.

use analysis::host::STEAL_LIMIT_PERCENT;
use analysis::statistics::{
    Events, Interval, median, median_interval, pooled, rate_ratio_interval,
};
use serde::{Deserialize, Serialize};

/// Ours and the floor's, one right after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorPair<T> {
    pub ours: T,
    pub floor: T,
    /// Time that the host took meanwhile from the processor that was measured [%].
    pub steal_percent: f64,
}

/// Pairs of one kind, in the order of measuring.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "pairs", rename_all = "snake_case")]
pub enum Pairs {
    /// Each pair has a ratio; their median counts.
    Ratio(Vec<FloorPair<f64>>),
    /// Rare events: the rate of all of ours over that of all of the floor's.
    Events(Vec<FloorPair<Events>>),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorComparison {
    pub name: String,
    pub unit: String,
    pub pairs: Pairs,
}

impl FloorComparison {
    pub fn ratio(name: &str, unit: &str) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            pairs: Pairs::Ratio(Vec::new()),
        }
    }

    /// A comparison of rates of events, which are printed per million.
    pub fn events(name: &str) -> Self {
        Self {
            pairs: Pairs::Events(Vec::new()),
            ..Self::ratio(name, "per million")
        }
    }

    /// Takes the next pair of values; one of a comparison of events is ignored.
    pub fn take(&mut self, ours: f64, floor: f64, steal_percent: f64) {
        if let Pairs::Ratio(pairs) = &mut self.pairs {
            pairs.push(FloorPair {
                ours,
                floor,
                steal_percent,
            });
        }
    }

    /// Takes the next pair of counts; one of a comparison of values is ignored.
    pub fn take_events(&mut self, ours: Events, floor: Events, steal_percent: f64) {
        if let Pairs::Events(pairs) = &mut self.pairs {
            pairs.push(FloorPair {
                ours,
                floor,
                steal_percent,
            });
        }
    }

    pub fn measured(&self) -> (usize, usize) {
        let (all, left) = match &self.pairs {
            Pairs::Ratio(pairs) => (pairs.len(), undisturbed(pairs).count()),
            Pairs::Events(pairs) => (pairs.len(), undisturbed(pairs).count()),
        };
        (all, all - left)
    }

    /// Ours and the floor's: medians of the pairs that count, or rates per million of all their events.
    pub fn sides(&self) -> [f64; 2] {
        match &self.pairs {
            Pairs::Ratio(pairs) => {
                let sides: [fn(&FloorPair<f64>) -> f64; 2] = [|pair| pair.ours, |pair| pair.floor];
                sides.map(|side| median(&undisturbed(pairs).map(side).collect::<Vec<_>>()))
            }
            Pairs::Events(pairs) => pooled(&counts(pairs)).map(|events| events.rate() * 1e6),
        }
    }

    /// The ratio; not a number without pairs that count.
    pub fn value(&self) -> f64 {
        match &self.pairs {
            Pairs::Ratio(pairs) => median(&ratios(pairs)),
            Pairs::Events(pairs) => {
                let [ours, floor] = pooled(&counts(pairs));
                ours.rate() / floor.rate()
            }
        }
    }

    /// Where the ratio lies with 95 %; none for too few pairs.
    pub fn interval(&self) -> Option<Interval> {
        match &self.pairs {
            Pairs::Ratio(pairs) => median_interval(&ratios(pairs)),
            Pairs::Events(pairs) => rate_ratio_interval(&counts(pairs)),
        }
    }
}

fn undisturbed<T>(pairs: &[FloorPair<T>]) -> impl Iterator<Item = &FloorPair<T>> {
    pairs
        .iter()
        .filter(|pair| pair.steal_percent <= STEAL_LIMIT_PERCENT)
}

fn ratios(pairs: &[FloorPair<f64>]) -> Vec<f64> {
    undisturbed(pairs)
        .map(|pair| pair.ours / pair.floor)
        .collect()
}

fn counts(pairs: &[FloorPair<Events>]) -> Vec<[Events; 2]> {
    undisturbed(pairs)
        .map(|pair| [pair.ours, pair.floor])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_ratios(ratios: &[f64]) -> FloorComparison {
        let mut comparison = FloorComparison::ratio("x", "us");
        for ratio in ratios {
            comparison.take(10.0 * ratio, 10.0, 0.0);
        }
        comparison
    }

    #[test]
    fn a_ratio_is_that_of_the_undisturbed_pairs() {
        let near = [1.2, 1.24, 1.26, 1.22, 1.24, 1.25, 1.21, 1.23, 1.24];
        let mut comparison = of_ratios(&near);
        comparison.take(1000.0, 10.0, 1.1);
        let interval = comparison.interval().map(|it| [it.low, it.high]);
        assert_eq!(interval, Some([1.21, 1.25]));
        assert_eq!((comparison.measured(), comparison.value()), ((10, 1), 1.24));
        assert_eq!(of_ratios(&near[..5]).interval(), None);
        let mut many = FloorComparison::events("misses");
        for (ours, floor) in [(60, 70), (80, 75), (70, 74), (66, 70), (71, 72), (69, 70)] {
            let exposure = 11_000;
            let [ours, floor] = [ours, floor].map(|count| Events { count, exposure });
            many.take_events(ours, floor, 0.0);
        }
        assert!((many.value() - 416.0 / 431.0).abs() < 1e-12);
        assert!((many.sides()[0] - 416e6 / 66_000.0).abs() < 1e-6);
    }
}
