//! Compares measurements with their floors, pair by pair.
//!
//! Both sides of a pair are measured within the same minute. The comparison also says whether the pairs allow a
//! verdict.

use serde::{Deserialize, Serialize};

/// Stolen time from which on a pair says nothing [%].
pub const STEAL_LIMIT_PERCENT: f64 = 1.0;
/// Events on the floor's side below which a ratio of counts says nothing.
pub const EVENTS_NEEDED: f64 = 10.0;

/// Ours and the floor's, one right after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorPair {
    /// Of the rig.
    pub ours: f64,
    /// Of what the machine can do at the best.
    pub floor: f64,
    /// Time that the host took meanwhile [%].
    pub steal_percent: f64,
}

/// How pairs become one ratio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RatioKind {
    /// Each pair has a ratio; the median counts, and the spread is from the smallest to the largest.
    Ratio,
    /// Counts of rare events: all of ours over all of the floor's; the spread is that with any one pair left out.
    Events,
    /// Ours less the floor's, in the unit, over what the difference was made to be.
    Difference,
}

/// A figure beside its floor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorComparison {
    /// What is compared.
    pub name: String,
    /// Of both sides.
    pub unit: String,
    /// How pairs become one ratio.
    pub kind: RatioKind,
    /// The ratio should not be above it; for [`Kind::Difference`] what the difference was made to be, in the unit.
    pub goal: f64,
    /// In the order of measuring.
    pub pairs: Vec<FloorPair>,
}

/// What the pairs allow to say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum GoalVerdict {
    /// The goal is met.
    Met,
    /// It is not.
    Missed,
    /// Nothing, and why.
    Inconclusive(String),
}

/// Half of how far a difference may be off, as a share of what it was made to be.
const DIFFERENCE_TOLERANCE: f64 = 0.1;

impl FloorComparison {
    /// A comparison without pairs yet.
    #[must_use]
    pub fn new(name: &str, unit: &str, kind: RatioKind, goal: f64) -> Self {
        Self { name: name.into(), unit: unit.into(), kind, goal, pairs: Vec::new() }
    }

    /// Median of ours and of the floor's.
    #[must_use]
    pub fn sides(&self) -> (f64, f64) {
        let of = |side: fn(&FloorPair) -> f64| median(self.pairs.iter().map(side).collect());
        (of(|pair| pair.ours), of(|pair| pair.floor))
    }

    /// The ratio; not a number without pairs.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        match self.kind {
            RatioKind::Events => events_ratio(self.pairs.iter()),
            _ => median(self.ratios()),
        }
    }

    /// Smallest and largest ratio.
    #[must_use]
    pub fn spread(&self) -> (f64, f64) {
        let ratios = match self.kind {
            RatioKind::Events if self.pairs.len() > 1 => (0..self.pairs.len())
                .map(|left_out| {
                    events_ratio(self.pairs.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, pair)| pair))
                })
                .collect(),
            RatioKind::Events => vec![self.ratio()],
            _ => self.ratios(),
        };
        let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        (least, ratios.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    }

    /// Whether the goal is met, if the pairs allow to say so.
    #[must_use]
    pub fn verdict(&self) -> GoalVerdict {
        if self.pairs.is_empty() {
            return GoalVerdict::Inconclusive("nothing was measured".into());
        }
        let steal = self.pairs.iter().map(|pair| pair.steal_percent).fold(0.0, f64::max);
        if steal > STEAL_LIMIT_PERCENT {
            return GoalVerdict::Inconclusive(format!("the host stole up to {steal:.1} %"));
        }
        let events: f64 = self.pairs.iter().map(|pair| pair.floor).sum();
        if self.kind == RatioKind::Events && events < EVENTS_NEEDED {
            return GoalVerdict::Inconclusive(format!("{events} events on the floor's side"));
        }
        let (ratio, (least, most)) = (self.ratio(), self.spread());
        let distance = if self.kind == RatioKind::Difference {
            DIFFERENCE_TOLERANCE - (ratio - 1.0).abs()
        } else {
            self.goal - ratio
        };
        if most - least > 2.0 * distance.abs() {
            return GoalVerdict::Inconclusive("the spread is wider than the distance to the goal".into());
        }
        if distance >= 0.0 { GoalVerdict::Met } else { GoalVerdict::Missed }
    }

    fn ratios(&self) -> Vec<f64> {
        let ratio = |pair: &FloorPair| match self.kind {
            RatioKind::Difference => (pair.ours - pair.floor) / self.goal,
            _ => pair.ours / pair.floor,
        };
        self.pairs.iter().map(ratio).collect()
    }
}

fn events_ratio<'a>(pairs: impl Iterator<Item = &'a FloorPair>) -> f64 {
    let (ours, floor) = pairs.fold((0.0, 0.0), |(ours, floor), pair| (ours + pair.ours, floor + pair.floor));
    ours / floor
}

/// The middle value, or the mean of the two in the middle; not a number where there is none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.as_slice() {
        [] => f64::NAN,
        sorted if sorted.len() % 2 == 1 => sorted[middle],
        sorted => f64::midpoint(sorted[middle - 1], sorted[middle]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn comparison(kind: RatioKind, goal: f64, pairs: &[(f64, f64)]) -> FloorComparison {
        let pairs =
            pairs.iter().map(|(ours, floor)| FloorPair { ours: *ours, floor: *floor, steal_percent: 0.0 }).collect();
        FloorComparison { pairs, ..FloorComparison::new("x", "us", kind, goal) }
    }

    #[test]
    fn a_goal_is_met_or_missed_only_where_the_spread_leaves_no_doubt() {
        let near = [(12.0, 10.0), (12.4, 10.0), (12.6, 10.0), (12.2, 10.0), (12.4, 10.0)];
        assert_eq!(comparison(RatioKind::Ratio, 1.5, &near).verdict(), GoalVerdict::Met);
        assert_eq!(comparison(RatioKind::Ratio, 1.1, &near).verdict(), GoalVerdict::Missed);
        let said = comparison(RatioKind::Ratio, 1.25, &near).verdict();
        assert!(matches!(said, GoalVerdict::Inconclusive(why) if why.contains("spread")));
        let (ratio, spread) =
            (comparison(RatioKind::Ratio, 1.5, &near).ratio(), comparison(RatioKind::Ratio, 1.5, &near).spread());
        assert!((ratio - 1.24).abs() < 1e-12 && (spread.0 - 1.2).abs() < 1e-12 && (spread.1 - 1.26).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_said_where_the_host_stole() {
        let mut stolen = comparison(RatioKind::Ratio, 1.5, &[(1.0, 1.0); 5]);
        stolen.pairs[3].steal_percent = 1.1;
        assert!(matches!(stolen.verdict(), GoalVerdict::Inconclusive(why) if why.contains("1.1 %")));
        assert!(matches!(comparison(RatioKind::Ratio, 1.5, &[]).verdict(), GoalVerdict::Inconclusive(_)));
    }

    #[test]
    fn rare_events_are_pooled_and_need_some() {
        let rare = comparison(RatioKind::Events, 1.2, &[(0.0, 1.0), (3.0, 0.0), (1.0, 2.0)]);
        assert!(matches!(rare.verdict(), GoalVerdict::Inconclusive(why) if why.starts_with("3 events")));
        let many = comparison(RatioKind::Events, 1.2, &[(60.0, 70.0), (80.0, 75.0), (70.0, 74.0)]);
        assert!((many.ratio() - 210.0 / 219.0).abs() < 1e-12);
        assert_eq!(many.verdict(), GoalVerdict::Met);
    }

    #[test]
    fn a_difference_is_held_against_what_it_was_made_to_be() {
        let seen = comparison(RatioKind::Difference, 20.0, &[(41.0, 21.0), (41.2, 20.9), (41.1, 21.2)]);
        assert!((seen.ratio() - 1.0).abs() < 0.02);
        assert_eq!(seen.verdict(), GoalVerdict::Met);
        let unseen = comparison(RatioKind::Difference, 20.0, &[(21.1, 21.0), (21.2, 20.9), (21.0, 21.2)]);
        assert_eq!(unseen.verdict(), GoalVerdict::Missed);
    }
}
