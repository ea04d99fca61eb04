//! What repeated measurements support: an interval for a median, one for a ratio of rates, and a test over groups.
//!
//! Nothing here supposes a shape of the distribution. What is resampled or permuted are whole measurements (a pair, a
//! flight), because values within one of them depend on each other.

use serde::{Deserialize, Serialize};
use statrs::distribution::{Binomial, DiscreteCDF as _};

/// Probability with which an interval of this file holds what it is of, at the least.
pub const CONFIDENCE: f64 = 0.95;
/// Fewest values that an interval of the median needs: the extremes of six hold it with 96.9 %, those of five with
/// 93.8 %.
pub const VALUES_NEEDED: usize = 6;
/// Resamplings of a bootstrap.
const RESAMPLINGS: usize = 10_000;
/// Any number: the same measurements have the same interval each time.
const SEED: u64 = 0x6972_6f6e_6269_7264;

/// Where something lies with [`CONFIDENCE`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// The middle value, or the mean of the two in the middle; not a number where there is none.
#[must_use]
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.as_slice() {
        [] => f64::NAN,
        sorted if sorted.len() % 2 == 1 => sorted[middle],
        sorted => f64::midpoint(sorted[middle - 1], sorted[middle]),
    }
}

/// The interval of the median of what the values were drawn from; none for fewer than [`VALUES_NEEDED`].
#[must_use]
pub fn median_interval(values: &[f64]) -> Option<Interval> {
    let (low, high) = ranks(values.len() as u64, 0.5)?;
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let of_rank = |rank: u64| sorted.get(usize::try_from(rank).ok()?.checked_sub(1)?).copied();
    Some(Interval { low: of_rank(low)?, high: of_rank(high)? })
}

/// Ranks, from 1, of the values between which a quantile lies with [`CONFIDENCE`] (order statistics: how many of
/// `count` independent values do not exceed the quantile is binomial); none where `count` is too small for both.
#[must_use]
pub fn ranks(count: u64, quantile: f64) -> Option<(u64, u64)> {
    let beyond = (1.0 - CONFIDENCE) / 2.0;
    let not_above = Binomial::new(quantile, count).ok()?;
    let (low, high) = (not_above.inverse_cdf(beyond), not_above.inverse_cdf(1.0 - beyond) + 1);
    (low >= 1 && high <= count).then_some((low, high))
}

/// Events that were counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Events {
    /// How many there were.
    pub count: u64,
    /// How many there could have been.
    pub exposure: u64,
}

impl Events {
    /// Events per chance; not a number without one.
    #[must_use]
    pub fn rate(self) -> f64 {
        self.count as f64 / self.exposure as f64
    }

    fn sum(all: impl Iterator<Item = Self>) -> Self {
        all.fold(Self::default(), |sum, one| Self {
            count: sum.count + one.count,
            exposure: sum.exposure + one.exposure,
        })
    }
}

/// All events of the first sides together, and of the second ones.
#[must_use]
pub fn pooled(pairs: &[[Events; 2]]) -> [Events; 2] {
    [0, 1].map(|side| Events::sum(pairs.iter().map(|pair| pair[side])))
}

/// The interval of the ratio of the first sides' rate to that of the second ones. None for fewer than two pairs.
///
/// A bootstrap over pairs keeps together what happened in the same minute. As few pairs may be alike by chance, the
/// rates of what is drawn vary, too, as those of so many independent events do (gamma, with half an event more).
#[must_use]
pub fn rate_ratio_interval(pairs: &[[Events; 2]]) -> Option<Interval> {
    if pairs.len() < 2 {
        return None;
    }
    let mut random = fastrand::Rng::with_seed(SEED);
    let mut ratios: Vec<f64> = (0..RESAMPLINGS)
        .map(|_| {
            let drawn: Vec<[Events; 2]> = (0..pairs.len()).map(|_| pairs[random.usize(..pairs.len())]).collect();
            let [ours, floor] = pooled(&drawn).map(|events| likely_rate(events, &mut random));
            ours / floor
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    let beyond = ((1.0 - CONFIDENCE) / 2.0 * RESAMPLINGS as f64) as usize;
    Some(Interval { low: ratios[beyond], high: ratios[RESAMPLINGS - 1 - beyond] })
}

/// A rate under which so many events are likely: their number and a half as shape of a gamma distribution.
fn likely_rate(events: Events, random: &mut fastrand::Rng) -> f64 {
    /// Beyond, the distribution's third root is normal to within a thousandth (Wilson and Hilferty).
    const FEW: u64 = 30;
    let mut exponential = || -(1.0 - random.f64()).ln();
    // Of Box and Muller.
    let length = (2.0 * exponential()).sqrt();
    let whole: f64 = (0..events.count.min(FEW)).map(|_| exponential()).sum();
    let normal = length * (std::f64::consts::TAU * random.f64()).cos();
    let shape = events.count as f64 + 0.5;
    let likely = if events.count <= FEW {
        whole + normal * normal / 2.0
    } else {
        shape * (1.0 - 1.0 / (9.0 * shape) + normal / (3.0 * shape.sqrt())).powi(3)
    };
    likely / events.exposure as f64
}

/// Two groups of values of one kind, one value a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    /// Of the first group's flights.
    pub a: Vec<f64>,
    /// Of the second group's, as many of each kind.
    pub b: Vec<f64>,
}

impl Groups {
    /// How far the groups lie apart: from the largest value of one to the smallest of the other; negative where they
    /// overlap.
    #[must_use]
    pub fn gap(&self) -> f64 {
        let ((low_a, high_a), (low_b, high_b)) = (ends(&self.a), ends(&self.b));
        (low_b - high_a).max(low_a - high_b)
    }

    /// How wide the wider one of them is.
    #[must_use]
    pub fn width(&self) -> f64 {
        [&self.a, &self.b].map(|group| ends(group)).iter().map(|(low, high)| high - low).fold(0.0, f64::max)
    }
}

/// The smallest and the largest value.
fn ends(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(*value), high.max(*value)))
}

/// Probability, for each kind of value, that chance alone sets any of the kinds as far apart as this one is.
///
/// Flights that are alike can change places between the groups. All ways to deal them out are tried (at most some
/// thousand, otherwise as many at random); how far the groups are apart is the difference of their means over their
/// spread, and each way is represented by its largest one. This holds the probability of any false verdict among all
/// kinds, however they depend on each other (Westfall and Young's maxT, in one step).
///
/// The values of a kind are `None` where it cannot be judged: fewer than two values a side, or one that is no number.
#[must_use]
pub fn permutation_test(kinds: &[Groups]) -> Vec<Option<f64>> {
    let Some(first) = kinds.first() else { return Vec::new() };
    let (in_a, flights) = (first.a.len(), first.a.len() + first.b.len());
    let pools: Vec<Option<Vec<f64>>> = kinds
        .iter()
        .map(|kind| {
            let pool = [&kind.a[..], &kind.b[..]].concat();
            let is_usable = kind.a.len() == in_a && in_a >= 2 && pool.len() == flights && flights - in_a >= 2;
            (is_usable && pool.iter().all(|value| value.is_finite())).then_some(pool)
        })
        .collect();
    let apart = |of_a: &[bool]| -> Vec<f64> {
        pools.iter().map(|pool| pool.as_ref().map_or(0.0, |pool| distance(pool, of_a))).collect()
    };
    let seen = apart(&(0..flights).map(|flight| flight < in_a).collect::<Vec<_>>());
    let mut as_far = vec![0_usize; kinds.len()];
    let mut ways = 0_usize;
    for of_a in deals(flights, in_a) {
        ways += 1;
        let largest = apart(&of_a).into_iter().fold(0.0, f64::max);
        for (count, seen) in as_far.iter_mut().zip(&seen) {
            // What is rounded differently is as far apart all the same.
            *count += usize::from(largest >= seen * (1.0 - 1e-9));
        }
    }
    let probability = |count: usize| count as f64 / ways as f64;
    pools.iter().zip(as_far).map(|(pool, count)| pool.is_some().then(|| probability(count))).collect()
}

/// Ways to deal flights out beyond which they are drawn instead.
const DEALS: usize = 5_000;

/// Which flights are in the first group, for every way to choose that many, or for many of them.
fn deals(flights: usize, in_a: usize) -> Vec<Vec<bool>> {
    let ways = (0..in_a).try_fold(1_usize, |ways, i| Some(ways.checked_mul(flights - i)? / (i + 1)));
    let as_it_was: Vec<bool> = (0..flights).map(|flight| flight < in_a).collect();
    if ways.is_some_and(|ways| ways <= DEALS) {
        let mut all = vec![Vec::new()];
        for flight in 0..flights {
            let may_be = |dealt: &Vec<bool>| {
                let chosen = dealt.iter().filter(|is_in_a| **is_in_a).count();
                [chosen < in_a, flight - chosen < flights - in_a]
            };
            all = all
                .into_iter()
                .flat_map(|dealt| {
                    let [in_first, in_second] = may_be(&dealt);
                    let with = move |is_in_a: bool| [dealt.as_slice(), &[is_in_a]].concat();
                    [in_first.then(|| with(true)), in_second.then(|| with(false))]
                        .into_iter()
                        .flatten()
                        .collect::<Vec<_>>()
                })
                .collect();
        }
        return all;
    }
    let mut random = fastrand::Rng::with_seed(SEED);
    let drawn = (1..DEALS).map(|_| {
        let mut dealt = as_it_was.clone();
        random.shuffle(&mut dealt);
        dealt
    });
    std::iter::once(as_it_was.clone()).chain(drawn).collect()
}

/// Distance of two groups' means over the spread within them.
fn distance(pool: &[f64], of_a: &[bool]) -> f64 {
    let side = |wanted: bool| -> (f64, f64, f64) {
        let values = || pool.iter().zip(of_a).filter(move |(_, is_in_a)| **is_in_a == wanted).map(|(value, _)| *value);
        let count = values().count() as f64;
        let mean = values().sum::<f64>() / count;
        (count, mean, values().map(|value| (value - mean).powi(2)).sum())
    };
    let ((n_a, mean_a, squares_a), (n_b, mean_b, squares_b)) = (side(true), side(false));
    let difference = (mean_a - mean_b).abs();
    if difference == 0.0 {
        return 0.0;
    }
    difference / ((squares_a + squares_b) / (n_a + n_b - 2.0) * (1.0 / n_a + 1.0 / n_b)).sqrt()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn groups_lie_apart_from_end_to_end() {
        let groups = |a: &[f64], b: &[f64]| Groups { a: a.to_vec(), b: b.to_vec() };
        let apart = groups(&[3.0, 1.0, 2.0], &[9.0, 6.0, 7.0]);
        assert_eq!((apart.gap(), apart.width()), (3.0, 3.0));
        assert_eq!(groups(&[9.0, 6.0], &[3.0, 1.0]).gap(), 3.0);
        assert_eq!(groups(&[1.0, 5.0], &[4.0, 6.0]).gap(), -1.0);
    }

    #[test]
    fn the_median_is_held_as_often_as_said_and_more_values_hold_it_closer() {
        let mut random = fastrand::Rng::with_seed(1);
        let mut widths = Vec::new();
        for count in [6, 9, 20, 60] {
            let runs = 4_000;
            let mut width = 0.0;
            let held = (0..runs)
                .filter(|_| {
                    // Skewed, as latencies are; the median of -ln u is ln 2.
                    let values: Vec<f64> = (0..count).map(|_| -random.f64().max(1e-300).ln()).collect();
                    let interval = median_interval(&values).unwrap();
                    width += interval.high - interval.low;
                    (interval.low..=interval.high).contains(&std::f64::consts::LN_2)
                })
                .count() as f64
                / f64::from(runs);
            // 4 standard deviations of 4000 draws; ranks are whole, so that it is held more often, but not always.
            assert!((CONFIDENCE - 0.014..0.9999).contains(&held), "{count} values: {held}");
            widths.push(width);
        }
        assert!(widths.windows(2).all(|pair| pair[1] < pair[0]), "{widths:?}");
        assert_eq!(median_interval(&[1.0; VALUES_NEEDED - 1]), None);
        // Of nine, the second and the eighth.
        let nine: Vec<f64> = (1..=9).map(f64::from).collect();
        assert_eq!(median_interval(&nine), Some(Interval { low: 2.0, high: 8.0 }));
    }

    #[test]
    fn a_ratio_of_rates_knows_how_little_few_pairs_say() {
        let events = |count: u64| Events { count, exposure: 11_000 };
        let pair = |ours: u64, floor: u64| [events(ours), events(floor)];
        // As once measured: three of nine flights had no miss, two had three times the floor's.
        let uneven = [(0, 9), (0, 12), (0, 8), (40, 16), (38, 12), (6, 14), (5, 11), (4, 13), (3, 12)]
            .map(|(ours, floor)| pair(ours, floor));
        let [ours, floor] = pooled(&uneven);
        assert_eq!((ours.count, floor.count), (96, 107));
        let interval = rate_ratio_interval(&uneven).unwrap();
        assert!(interval.low < 0.6 && interval.high > 1.3, "{interval:?}");
        let even = rate_ratio_interval(&[pair(100, 101); 9]).unwrap();
        // Nine hundred events a side say no more than 9 %, however alike the pairs are.
        assert!((0.88..0.93).contains(&even.low) && (1.06..1.11).contains(&even.high), "{even:?}");
        assert!(rate_ratio_interval(&[pair(1, 0), pair(3, 1)]).unwrap().high > 20.0);
        assert!(rate_ratio_interval(&[pair(0, 9); 9]).unwrap().high < 0.1, "none of 81");
        assert_eq!(rate_ratio_interval(&[pair(1, 1)]), None);
        assert_eq!(rate_ratio_interval(&uneven), rate_ratio_interval(&uneven), "no run of the program is another");
    }

    #[test]
    fn a_ratio_of_rates_is_held_about_as_often_as_said() {
        let mut random = fastrand::Rng::with_seed(4);
        for (pairs, mean, own) in [(6, 3.0, 0.0), (9, 12.0, 0.0), (9, 12.0, 0.5), (20, 12.0, 0.5)] {
            let runs = 300;
            let held = (0..runs)
                .filter(|_| {
                    let mut side = || {
                        let mean = mean * (1.0 + own * (2.0 * random.f64() - 1.0));
                        // As many as come before the time is over.
                        let mut time = 0.0;
                        let mut count = 0;
                        loop {
                            time -= (1.0 - random.f64()).ln() / mean;
                            if time > 1.0 {
                                return Events { count, exposure: 11_000 };
                            }
                            count += 1;
                        }
                    };
                    let all: Vec<[Events; 2]> = (0..pairs).map(|_| [side(), side()]).collect();
                    rate_ratio_interval(&all).is_some_and(|it| (it.low..=it.high).contains(&1.0))
                })
                .count();
            // 3 standard deviations of 300 draws.
            assert!(held as f64 >= f64::from(runs) * (CONFIDENCE - 0.038), "{pairs} pairs of {mean}: {held} of {runs}");
        }
    }

    #[test]
    fn groups_that_are_alike_are_seldom_told_apart_however_many_kinds_there_are() {
        let mut random = fastrand::Rng::with_seed(2);
        let (runs, kinds, each) = (400, 40, 4);
        let falsely = (0..runs)
            .filter(|_| {
                // What a flight has of its own is in all of its kinds.
                let own: Vec<f64> = (0..2 * each).map(|_| random.f64()).collect();
                let groups: Vec<Groups> = (0..kinds)
                    .map(|_| {
                        let values: Vec<f64> = own.iter().map(|own| own + random.f64()).collect();
                        Groups { a: values[..each].to_vec(), b: values[each..].to_vec() }
                    })
                    .collect();
                permutation_test(&groups).into_iter().flatten().any(|probability| probability <= 0.05)
            })
            .count();
        // At most 5 %, and 4 standard deviations more.
        assert!(falsely as f64 <= f64::from(runs) * 0.05 + 18.0, "{falsely} of {runs}");
    }

    #[test]
    fn a_difference_beyond_the_spread_is_found_among_kinds_without_one() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut group = |mean: f64| (0..4).map(|_| mean + random.f64()).collect::<Vec<_>>();
        let mut kinds: Vec<Groups> = (0..40).map(|_| Groups { a: group(10.0), b: group(10.0) }).collect();
        kinds.push(Groups { a: group(10.0), b: group(30.0) });
        let found = permutation_test(&kinds);
        // Two of the 70 ways to deal 4 of 8 set them as far apart.
        assert_eq!(found.last().copied().flatten(), Some(2.0 / 70.0));
        assert!(found[..40].iter().all(|probability| probability.unwrap() > 0.05), "{found:?}");
    }

    #[test]
    fn what_cannot_be_judged_is_not() {
        let judged = |a: &[f64], b: &[f64]| permutation_test(&[Groups { a: a.to_vec(), b: b.to_vec() }]);
        assert_eq!(judged(&[1.0], &[2.0, 3.0]), [None]);
        assert_eq!(judged(&[1.0, f64::NAN], &[2.0, 3.0]), [None]);
        assert_eq!(judged(&[1.0, 1.0], &[1.0, 1.0]), [Some(1.0)]);
        // The least that three a side can say.
        assert_eq!(judged(&[1.0, 1.1, 1.2], &[2.0, 2.1, 2.2]), [Some(0.1)]);
        assert_eq!(permutation_test(&[]), []);
    }

    #[test]
    fn all_ways_to_deal_are_tried_where_they_are_few_and_many_otherwise() {
        assert_eq!(deals(6, 3).len(), 20);
        let all: BTreeSet<Vec<bool>> = deals(6, 3).into_iter().collect();
        assert_eq!(all.len(), 20, "no way twice");
        let drawn: BTreeSet<Vec<bool>> = deals(30, 15).into_iter().collect();
        assert!(drawn.len() > DEALS * 9 / 10, "{} of {DEALS}", drawn.len());
        assert!(deals(6, 3).iter().all(|dealt| dealt.iter().filter(|is_in_a| **is_in_a).count() == 3));
        assert_eq!(deals(30, 15).len(), DEALS);
        assert_eq!(deals(30, 15)[0].iter().filter(|is_in_a| **is_in_a).count(), 15);
    }
}
