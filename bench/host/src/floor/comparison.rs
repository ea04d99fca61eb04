//! Compares measurements with their floors, pair by pair.
//!
//! Both sides of a pair are measured within the same minute. The comparison also says whether the pairs allow a
//! verdict: only where the interval of the ratio ([`analysis::statistics`]) lies on one side of the goal.

use analysis::host::STEAL_LIMIT_PERCENT;
use analysis::statistics::{
    Events, Interval, VALUES_NEEDED, median, median_interval, pooled, rate_ratio_interval,
};
use serde::{Deserialize, Serialize};

/// Events on the floor's side below which a ratio of rates says nothing.
const EVENTS_NEEDED: u64 = 10;

/// Ours and the floor's, one right after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorPair<T> {
    pub ours: T,
    pub floor: T,
    /// Time that the host took meanwhile from the processor that was measured [%].
    pub steal_percent: f64,
}

/// Pairs of one kind, in the order of measuring; their ratio should not be above the goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Pairs {
    /// Each pair has a ratio; their median counts.
    Ratio {
        goal: f64,
        pairs: Vec<FloorPair<f64>>,
    },
    /// Rare events: the rate of all of ours over that of all of the floor's.
    Events {
        goal: f64,
        pairs: Vec<FloorPair<Events>>,
    },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorComparison {
    pub name: String,
    pub unit: String,
    pub pairs: Pairs,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum GoalVerdict {
    Met,
    Missed,
    Inconclusive(String),
}

impl FloorComparison {
    fn new(name: &str, unit: &str, pairs: Pairs) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            pairs,
        }
    }

    pub fn ratio(name: &str, unit: &str, goal: f64) -> Self {
        let pairs = Vec::new();
        Self::new(name, unit, Pairs::Ratio { goal, pairs })
    }

    /// A comparison of rates of events, which are printed per million.
    pub fn events(name: &str, goal: f64) -> Self {
        let pairs = Vec::new();
        Self::new(name, "per million", Pairs::Events { goal, pairs })
    }

    /// Takes the next pair of values; one of a comparison of events is ignored.
    pub fn take(&mut self, ours: f64, floor: f64, steal_percent: f64) {
        if let Pairs::Ratio { pairs, .. } = &mut self.pairs {
            pairs.push(FloorPair {
                ours,
                floor,
                steal_percent,
            });
        }
    }

    /// Takes the next pair of counts; one of a comparison of values is ignored.
    pub fn take_events(&mut self, ours: Events, floor: Events, steal_percent: f64) {
        if let Pairs::Events { pairs, .. } = &mut self.pairs {
            pairs.push(FloorPair {
                ours,
                floor,
                steal_percent,
            });
        }
    }

    pub fn measured(&self) -> (usize, usize) {
        let (all, left) = match &self.pairs {
            Pairs::Ratio { pairs, .. } => (pairs.len(), undisturbed(pairs).count()),
            Pairs::Events { pairs, .. } => (pairs.len(), undisturbed(pairs).count()),
        };
        (all, all - left)
    }

    /// Ours and the floor's: medians of the pairs that count, or rates per million of all their events.
    pub fn sides(&self) -> [f64; 2] {
        match &self.pairs {
            Pairs::Ratio { pairs, .. } => {
                let sides: [fn(&FloorPair<f64>) -> f64; 2] = [|pair| pair.ours, |pair| pair.floor];
                sides.map(|side| median(&undisturbed(pairs).map(side).collect::<Vec<_>>()))
            }
            Pairs::Events { pairs, .. } => pooled(&counts(pairs)).map(|events| events.rate() * 1e6),
        }
    }

    /// The ratio; not a number without pairs that count.
    pub fn value(&self) -> f64 {
        match &self.pairs {
            Pairs::Ratio { pairs, .. } => median(&ratios(pairs)),
            Pairs::Events { pairs, .. } => {
                let [ours, floor] = pooled(&counts(pairs));
                ours.rate() / floor.rate()
            }
        }
    }

    /// Where the ratio lies with 95 %; none for too few pairs.
    pub fn interval(&self) -> Option<Interval> {
        match &self.pairs {
            Pairs::Ratio { pairs, .. } => median_interval(&ratios(pairs)),
            Pairs::Events { pairs, .. } => rate_ratio_interval(&counts(pairs)),
        }
    }

    pub fn verdict(&self) -> GoalVerdict {
        let (measured, disturbed) = self.measured();
        if measured - disturbed < VALUES_NEEDED {
            let disturbed = match disturbed {
                0 => String::new(),
                pairs => format!(", {pairs} left out: the host stole"),
            };
            return GoalVerdict::Inconclusive(format!(
                "{measured} pairs{disturbed}; {VALUES_NEEDED} are needed"
            ));
        }
        if let Pairs::Events { pairs, .. } = &self.pairs {
            let count = pooled(&counts(pairs))[1].count;
            if count < EVENTS_NEEDED {
                return GoalVerdict::Inconclusive(format!(
                    "the floor has {count} events; {EVENTS_NEEDED} are needed"
                ));
            }
        }
        match self.interval() {
            Some(Interval { high, .. }) if high <= self.goal() => GoalVerdict::Met,
            Some(Interval { low, .. }) if low > self.goal() => GoalVerdict::Missed,
            _ => GoalVerdict::Inconclusive("goal within the interval".into()),
        }
    }

    pub const fn goal(&self) -> f64 {
        match self.pairs {
            Pairs::Ratio { goal, .. } | Pairs::Events { goal, .. } => goal,
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

    fn of_ratios(goal: f64, ratios: &[f64]) -> FloorComparison {
        let mut comparison = FloorComparison::ratio("x", "us", goal);
        for ratio in ratios {
            comparison.take(10.0 * ratio, 10.0, 0.0);
        }
        comparison
    }

    fn of_events(pairs: &[(u64, u64)]) -> FloorComparison {
        let mut comparison = FloorComparison::events("misses", 1.2);
        let exposure = 11_000;
        for (ours, floor) in pairs {
            let [ours, floor] = [*ours, *floor].map(|count| Events { count, exposure });
            comparison.take_events(ours, floor, 0.0);
        }
        comparison
    }

    #[test]
    fn a_verdict_needs_enough_pairs_that_leave_no_doubt() {
        let near = [1.2, 1.24, 1.26, 1.22, 1.24, 1.25, 1.21, 1.23, 1.24];
        let interval = of_ratios(1.5, &near).interval();
        assert_eq!(interval.map(|it| [it.low, it.high]), Some([1.21, 1.25]));
        // All of a skewed spread lies on one side: a far outlier changes nothing.
        let skewed = [1.01, 1.02, 1.02, 1.0, 1.03, 1.02, 1.04, 1.01, 9.0];
        let with_theft = |ratios: &[f64]| {
            let mut comparison = of_ratios(1.5, ratios);
            comparison.take(1000.0, 10.0, 1.1);
            comparison
        };
        let many = of_events(&[(60, 70), (80, 75), (70, 74), (66, 70), (71, 72), (69, 70)]);
        assert!((many.value() - 416.0 / 431.0).abs() < 1e-12);
        assert!((many.sides()[0] - 416e6 / 66_000.0).abs() < 1e-6);
        let rare = of_events(&[(0, 1), (3, 0), (1, 2), (0, 0), (0, 0), (1, 1)]);
        // Some flights without a miss, some with three times the floor's: nothing can be said.
        let none = [(0, 9), (0, 12), (0, 8), (6, 14), (5, 11), (4, 13), (3, 12)];
        let uneven = of_events(&[&none[..], &[(40, 16), (38, 12)]].concat());
        let stolen = with_theft(&[1.0; 6]);
        assert_eq!((stolen.measured(), stolen.value()), ((7, 1), 1.0));
        for (comparison, expected) in [
            (of_ratios(1.5, &near), "Met"),
            (of_ratios(1.1, &near), "Missed"),
            (of_ratios(1.235, &near), "within the interval"),
            (of_ratios(1.05, &skewed), "Met"),
            (stolen, "Met"),
            (
                with_theft(&[1.0; 5]),
                "6 pairs, 1 left out: the host stole; 6 are needed",
            ),
            (of_ratios(1.5, &[]), "0 pairs"),
            (many, "Met"),
            (rare, "the floor has 4 events"),
            (uneven, "within the interval"),
        ] {
            let verdict = format!("{:?}", comparison.verdict());
            assert!(verdict.contains(expected), "{verdict}, not {expected}");
        }
    }
}
