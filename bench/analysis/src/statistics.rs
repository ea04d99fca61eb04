//! Intervals and tests: of a median, a mean and a rate of success, and a test over groups.
//!
//! The bootstrap and the permutation test assume no shape of the distribution. They resample or permute whole
//! flights, because the values within a flight depend on each other.
//!
//! Sources: Efron and Tibshirani, "An Introduction to the Bootstrap" (1993), chapter 12 (bootstrap-t);
//! Wilson, "Probable inference" (1927);
//! Bonett and Price, "Adjusted Wald confidence interval for a difference of binomial proportions based on paired
//! data" (2012);
//! McNemar, "Note on the sampling error of the difference between correlated proportions" (1947), in its exact form;
//! Westfall and Young, "Resampling-Based Multiple Testing" (1993).

use fastrand::Rng;
use serde::{Deserialize, Serialize};
use statrs::distribution::{Binomial, DiscreteCDF as _};
use statrs::function::beta::beta_reg;
use statrs::function::erf::erfc;

/// Probability with which an interval contains the true value.
pub const CONFIDENCE: f64 = 0.95;
/// Fixed, so that the same flights always have the same verdict.
const SEED: u64 = 0x6972_6f6e_6269_7264;

/// The range that contains a value with [`CONFIDENCE`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    pub low: f64,
    pub high: f64,
}

impl Interval {
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    pub fn width(self) -> f64 {
        self.high - self.low
    }
}

/// The middle value, or the mean of the two in the middle; not a number where there is none.
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

/// The interval of the median of what the values were drawn from; none for fewer than six, because the extremes of five
/// hold it with 93.8 % only.
pub fn median_interval(values: &[f64]) -> Option<Interval> {
    let (low, high) = ranks(values.len() as u64, 0.5)?;
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let [low, high] = [low, high].map(|rank| sorted[rank as usize - 1]);
    Some(Interval::new(low, high))
}

/// Ranks, from 1, of the values between which a quantile lies with [`CONFIDENCE`] (order statistics: how many of
/// `count` independent values do not exceed the quantile is binomial); none where `count` is too small for both.
pub fn ranks(count: u64, quantile: f64) -> Option<(u64, u64)> {
    let beyond = (1.0 - CONFIDENCE) / 2.0;
    let not_above = Binomial::new(quantile, count).ok()?;
    let low = not_above.inverse_cdf(beyond);
    let high = not_above.inverse_cdf(1.0 - beyond) + 1;
    (low >= 1 && high <= count).then_some((low, high))
}

/// Two groups of values of one kind, one value a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    pub a: Vec<f64>,
    /// Of the second group's, as many of each kind.
    pub b: Vec<f64>,
}

impl Groups {
    /// How far the groups lie apart: from the largest value of one to the smallest of the other; negative where they
    /// overlap.
    pub fn gap(&self) -> f64 {
        let ((low_a, high_a), (low_b, high_b)) = (ends(&self.a), ends(&self.b));
        (low_b - high_a).max(low_a - high_b)
    }

    pub fn width(&self) -> f64 {
        let width = |(low, high)| high - low;
        width(ends(&self.a)).max(width(ends(&self.b)))
    }
}

fn ends(values: &[f64]) -> (f64, f64) {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    (
        low,
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    )
}

/// Probability, for each kind of value, that chance alone sets any of the kinds as far apart as this one is.
///
/// Flights that are alike can change places between the groups. All ways to deal them out are tried (at most some
/// thousand, otherwise as many at random); how far the groups are apart is the difference of their means over their
/// spread, and each way is represented by its largest one. This holds the probability of any false verdict among all
/// kinds, however they depend on each other (Westfall and Young's maxT, in one step).
///
/// The values of a kind are `None` where it cannot be judged: fewer than two values a side, or one that is no number.
pub fn permutation_test(kinds: &[Groups]) -> Vec<Option<f64>> {
    let Some(first) = kinds.first() else {
        return Vec::new();
    };
    let (in_a, flights) = (first.a.len(), first.a.len() + first.b.len());
    let pool = |kind: &Groups| {
        let pool = [&kind.a[..], &kind.b[..]].concat();
        let is_usable =
            kind.a.len() == in_a && in_a >= 2 && pool.len() == flights && flights - in_a >= 2;
        (is_usable && pool.iter().all(|value| value.is_finite())).then_some(pool)
    };
    let pools: Vec<Option<Vec<f64>>> = kinds.iter().map(pool).collect();
    let apart = |of_a: &[bool]| -> Vec<f64> {
        let pools = pools.iter().map(Option::as_ref);
        pools
            .map(|pool| pool.map_or(0.0, |pool| distance(pool, of_a)))
            .collect()
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
    let judged = pools.iter().zip(as_far);
    judged
        .map(|(pool, count)| pool.is_some().then(|| probability(count)))
        .collect()
}

/// Ways to deal flights out beyond which they are drawn instead.
const DEALS: usize = 5_000;

/// Which flights are in the first group, for every way to choose that many, or for many of them.
fn deals(flights: usize, in_a: usize) -> Vec<Vec<bool>> {
    let ways = (0..in_a).try_fold(1_usize, |ways, i| {
        Some(ways.checked_mul(flights - i)? / (i + 1))
    });
    let as_it_was: Vec<bool> = (0..flights).map(|flight| flight < in_a).collect();
    if ways.is_some_and(|ways| ways <= DEALS) {
        let mut all = vec![Vec::new()];
        for flight in 0..flights {
            let both = all.iter().flat_map(|dealt: &Vec<bool>| {
                [true, false].map(|is_in_a| [dealt.as_slice(), &[is_in_a]].concat())
            });
            let may_be = |dealt: &Vec<bool>| {
                let chosen = dealt.iter().filter(|is_in_a| **is_in_a).count();
                chosen <= in_a && flight + 1 - chosen <= flights - in_a
            };
            all = both.filter(may_be).collect();
        }
        return all;
    }
    let mut random = Rng::with_seed(SEED);
    let drawn = (1..DEALS).map(|_| {
        let mut dealt = as_it_was.clone();
        random.shuffle(&mut dealt);
        dealt
    });
    std::iter::once(as_it_was.clone()).chain(drawn).collect()
}

fn distance(pool: &[f64], of_a: &[bool]) -> f64 {
    let side = |wanted: bool| {
        let side = pool.iter().zip(of_a);
        moments(side.filter_map(move |(value, is_in_a)| (*is_in_a == wanted).then_some(value)))
    };
    let ((n_a, mean_a, squares_a), (n_b, mean_b, squares_b)) = (side(true), side(false));
    let difference = (mean_a - mean_b).abs();
    if difference == 0.0 {
        return 0.0;
    }
    difference / ((squares_a + squares_b) / (n_a + n_b - 2.0) * (1.0 / n_a + 1.0 / n_b)).sqrt()
}

const Z: f64 = 1.959_963_984_540_054;

/// Wilson's score interval of `hits` of `trials`: the whole range without a trial.
pub fn wilson(hits: u64, trials: u64) -> Interval {
    if trials == 0 {
        return Interval::new(0.0, 1.0);
    }
    let (n, rate) = (trials as f64, hits as f64 / trials as f64);
    let spread = 1.0 + Z * Z / n;
    let middle = (rate + Z * Z / (2.0 * n)) / spread;
    let half = Z / spread * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    // At the ends it touches them, which rounding might miss.
    let low = if hits == 0 {
        0.0
    } else {
        (middle - half).max(0.0)
    };
    let high = if hits == trials {
        1.0
    } else {
        (middle + half).min(1.0)
    };
    Interval { low, high }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Discordant {
    pub first: u64,
    pub second: u64,
}

impl Discordant {
    /// How probable a split at least as uneven is, were both alike: McNemar's test, exact up to 10 000 pairs.
    pub fn p_value(self) -> f64 {
        const EXACT_MAX: u64 = 10_000;
        let (pairs, fewer) = (self.first + self.second, self.first.min(self.second));
        if pairs == 0 || self.first == self.second {
            return 1.0;
        }
        if pairs > EXACT_MAX {
            let distance = (self.first.abs_diff(self.second) as f64 - 1.0) / (pairs as f64).sqrt();
            return erfc(distance / std::f64::consts::SQRT_2);
        }
        // At most `fewer` heads in `pairs` throws: P = I_1/2(pairs - fewer, fewer + 1).
        (2.0 * beta_reg((pairs - fewer) as f64, fewer as f64 + 1.0, 0.5)).min(1.0)
    }

    /// Difference of the success rates, first less second, over all pairs, with its interval (Bonett and Price's: as if
    /// two more pairs had been seen, one of each kind; pairs without a difference do not show that there is none).
    pub fn difference(self, pairs: u64) -> MeanInterval {
        let (n, first, second) = (pairs as f64, self.first as f64, self.second as f64);
        let [first_rate, second_rate] = [first, second].map(|count| (count + 1.0) / (n + 2.0));
        let middle = first_rate - second_rate;
        let half = Z * ((first_rate + second_rate - middle * middle) / (n + 2.0)).sqrt();
        MeanInterval {
            count: pairs,
            mean: (first - second) / n.max(1.0),
            interval: Interval::new((middle - half).max(-1.0), (middle + half).min(1.0)),
        }
    }
}

const MEAN_RESAMPLINGS: usize = 1000;
/// Resamples of a mean beyond either end of its interval. At 25 of 1000, the interval of ten values of a lognormal
/// distribution would hold its mean with 91 % instead of 95 %.
const BEYOND_MEAN: usize = 12;
/// Values that are resampled at the most: more are taken together in blocks, which flights that know nothing of each
/// other allow.
const BLOCKS: usize = 2000;

/// Values that must differ from the most frequent one for an interval of their mean: with fewer, it holds in less than
/// 91 % (test `coverage_of_the_intervals_of_means_of_which_many_are_alike`).
pub const DIFFERING_LEAST: u64 = 8;

/// The mean of some values, with its bootstrap-t interval at 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mean {
    pub count: u64,
    pub mean: f64,
    /// Values that differ from the most frequent one.
    pub differing: u64,
    /// None if fewer than [`DIFFERING_LEAST`] differ: they do not tell how far their mean is off.
    #[serde(flatten)]
    pub interval: Option<Interval>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanInterval {
    pub count: u64,
    pub mean: f64,
    #[serde(flatten)]
    pub interval: Interval,
}

/// The mean of some values, of which NaN is none; none of fewer than ten values.
pub fn mean_interval(values: impl Iterator<Item = f64>) -> Option<Mean> {
    let values: Vec<f64> = values.filter(|value| !value.is_nan()).collect();
    if values.len() < 10 {
        return None;
    }
    let count = values.len() as u64;
    let differing = count - most_frequent(&values);
    Some(Mean {
        count,
        mean: mean_and_error(&values).0,
        differing,
        interval: (differing >= DIFFERING_LEAST)
            .then(|| bootstrap_t(values))
            .flatten(),
    })
}

/// How often the most frequent value occurs.
fn most_frequent(values: &[f64]) -> u64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let alike = sorted.chunk_by(|a, b| a == b).map(<[f64]>::len);
    alike.max().unwrap_or(0) as u64
}

/// The interval of the mean of values that are not all alike; none if they are alike block by block.
fn bootstrap_t(mut values: Vec<f64>) -> Option<Interval> {
    let mut random = Rng::with_seed(1);
    let blocks = values.len().min(BLOCKS);
    if blocks < values.len() {
        // What repeats from value to value, as factors on a grid do, does not repeat from block to block.
        random.shuffle(&mut values);
    }
    let cut = |block: usize| block * values.len() / blocks;
    let block = |block: usize| mean_and_error(&values[cut(block)..cut(block + 1)]).0;
    let blocked: Vec<f64> = (0..blocks).map(block).collect();
    let (mean, error) = mean_and_error(&blocked);
    if error == 0.0 {
        return None;
    }
    let mut drawn = vec![0.0; blocks];
    let mut distance = |random: &mut Rng| {
        loop {
            drawn.fill_with(|| blocked[random.usize(..blocks)]);
            let (of_drawn, error) = mean_and_error(&drawn);
            // Values that are all alike do not tell how far their mean is off.
            if error > 0.0 {
                return (of_drawn - mean) / error;
            }
        }
    };
    let distances = (0..MEAN_RESAMPLINGS).map(|_| distance(&mut random));
    let mut distances: Vec<f64> = distances.collect();
    distances.sort_unstable_by(f64::total_cmp);
    let (low, high) = (BEYOND_MEAN, MEAN_RESAMPLINGS - 1 - BEYOND_MEAN);
    Some(Interval::new(
        mean - distances[high] * error,
        mean - distances[low] * error,
    ))
}

/// The mean of some values and its standard error.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let (count, mean, squares) = moments(values.iter());
    (mean, (squares / (count - 1.0) / count).sqrt())
}

/// How many values there are, their mean, and the sum of the squares of their differences from it.
fn moments<'a>(values: impl Iterator<Item = &'a f64> + Clone) -> (f64, f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares = values.map(|value| (value - mean).powi(2)).sum();
    (count, mean, squares)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::f64::consts::LN_2;

    use super::*;

    fn groups(a: &[f64], b: &[f64]) -> Groups {
        let (a, b) = (a.to_vec(), b.to_vec());
        Groups { a, b }
    }

    fn contains(interval: Interval, value: f64) -> bool {
        (interval.low..=interval.high).contains(&value)
    }

    fn share(runs: usize, mut holds: impl FnMut() -> bool) -> f64 {
        (0..runs).filter(|_| holds()).count() as f64 / runs as f64
    }

    #[test]
    fn the_median_is_held_as_often_as_said_and_more_values_hold_it_closer() {
        let mut random = Rng::with_seed(1);
        let mut widths = Vec::new();
        for count in [6, 9, 20, 60] {
            let mut width = 0.0;
            let held = share(4_000, || {
                // Skewed, as latencies are; the median of -ln u is ln 2.
                let values = (0..count).map(|_| -random.f64().max(1e-300).ln());
                let interval = median_interval(&values.collect::<Vec<f64>>()).unwrap();
                width += interval.width();
                contains(interval, LN_2)
            });
            // 4 standard deviations of 4000 draws; ranks are whole, so that it is held more often, but not always.
            let expected = CONFIDENCE - 0.014..0.9999;
            assert!(expected.contains(&held), "{count} values: {held}");
            widths.push(width);
        }
        assert!(widths.is_sorted_by(|a, b| a > b), "{widths:?}");
        assert_eq!(median_interval(&[1.0; 5]), None);
        // Of nine, the second and the eighth.
        let nine: Vec<f64> = (1..=9).map(f64::from).collect();
        assert_eq!(median_interval(&nine), Some(Interval::new(2.0, 8.0)));
    }

    #[test]
    fn groups_that_are_alike_are_seldom_told_apart_however_many_kinds_there_are() {
        let mut random = Rng::with_seed(2);
        let falsely = share(400, || {
            // What a flight has of its own is in all of its kinds.
            let own: Vec<f64> = (0..8).map(|_| random.f64()).collect();
            let kind = |_| {
                let values: Vec<f64> = own.iter().map(|own| own + random.f64()).collect();
                groups(&values[..4], &values[4..])
            };
            let found = permutation_test(&(0..40).map(kind).collect::<Vec<_>>());
            found.into_iter().flatten().any(|p| p <= 0.05)
        });
        // At most 5 %, and 4 standard deviations more.
        assert!(falsely <= 0.05 + 18.0 / 400.0, "{falsely}");
    }

    #[test]
    fn kinds_with_too_few_values_or_without_numbers_are_not_judged() {
        let judged = |a: &[f64], b: &[f64]| permutation_test(&[groups(a, b)]);
        assert_eq!(judged(&[1.0], &[2.0, 3.0]), [None]);
        assert_eq!(judged(&[1.0, f64::NAN], &[2.0, 3.0]), [None]);
        assert_eq!(judged(&[1.0, 1.0], &[1.0, 1.0]), [Some(1.0)]);
        // The least that three a side can say.
        assert_eq!(judged(&[1.0, 1.1, 1.2], &[2.0, 2.1, 2.2]), [Some(0.1)]);
        assert_eq!(permutation_test(&[]), []);
        // Of many ways to deal, many are drawn.
        let drawn: BTreeSet<Vec<bool>> = deals(30, 15).into_iter().collect();
        assert!(drawn.len() >= DEALS * 9 / 10);
        let of_a = |dealt: &Vec<bool>| dealt.iter().filter(|it| **it).count();
        assert!(drawn.iter().all(|dealt| of_a(dealt) == 15));
    }

    #[test]
    fn intervals_are_those_of_the_tables() {
        let close = |interval: Interval, low: f64, high: f64| {
            let off = (interval.low - low).abs().max((interval.high - high).abs());
            let is_close = off <= 6e-3 * high.min(1.0 - low).max(1e-12);
            assert!(is_close, "{interval:?}, expected {low}..{high}");
        };
        // statsmodels.stats.proportion.proportion_confint, method "wilson".
        close(wilson(8, 10), 0.490_162, 0.943_318);
        close(wilson(3, 10_000), 1.020_3e-4, 8.817e-4);
        assert_eq!((wilson(0, 9).low, wilson(9, 9).high), (0.0, 1.0));
        assert_eq!(wilson(0, 0), Interval::new(0.0, 1.0));
    }

    #[test]
    fn uneven_pairs_are_improbable() {
        let p = |first, second| Discordant { first, second }.p_value();
        assert_eq!((p(0, 0), p(5, 5)), (1.0, 1.0));
        // 2 * (1 + 10) / 1024 and 2 / 1024.
        assert!((p(1, 9) - 22.0 / 1024.0).abs() < 1e-12 && (p(10, 0) - 2.0 / 1024.0).abs() < 1e-12);
        let (exact, asymptotic) = (p(5100, 4900), p(5101, 4901));
        assert!((exact / asymptotic - 1.0).abs() < 0.05);
        let found = Discordant {
            first: 30,
            second: 10,
        }
        .difference(200);
        let Interval { low, high } = found.interval;
        assert!((found.mean - 0.1).abs() < 1e-12);
        // 20/202 +- 1.959964 sqrt((42/202 - (20/202)^2) / 202)
        assert!(
            (low - 0.037_63).abs() < 1e-5 && (high - 0.160_39).abs() < 1e-5,
            "{found:?}"
        );
        let alike = Discordant {
            first: 0,
            second: 0,
        }
        .difference(50)
        .interval;
        assert!(
            (alike.high - 0.053_3).abs() < 1e-4 && alike.low == -alike.high,
            "{alike:?}"
        );
    }

    /// Prints the table of docs/campaigns.md, if it is built for release.
    #[test]
    fn coverage_of_the_intervals_of_pairs_and_means() {
        // Means are resampled a thousand times for each run. Of 200 runs, 4 standard deviations are 7 % of skewed values.
        const RUNS: usize = if cfg!(debug_assertions) { 200 } else { 4000 };
        const SKEWED: f64 = if cfg!(debug_assertions) { 0.86 } else { 0.92 };
        let mut random = Rng::with_seed(7);
        let pair = |random: &mut Rng, pairs: u64| {
            let first = (0..pairs).filter(|_| random.f64() < 0.01).count() as u64;
            Discordant { first, second: 0 }.difference(pairs).interval
        };
        for pairs in [50, 100, 200] {
            let held = share(RUNS, || contains(pair(&mut random, pairs), 0.01));
            println!(
                "one flight in 100 differs, {pairs} pairs: {:.1} %",
                100.0 * held
            );
            assert!(held >= 0.94, "{pairs} pairs: {held}");
        }
        type Draw = fn(&mut Rng) -> f64;
        let kinds: [(&str, Draw, f64, f64); 3] = [
            ("even", |random| random.f64() + random.f64(), 1.0, 0.92),
            (
                "exponential",
                |random| -(1.0 - random.f64()).ln(),
                1.0,
                0.92,
            ),
            (
                "lognormal",
                |random| normal(random).exp(),
                0.5_f64.exp(),
                SKEWED,
            ),
        ];
        for (name, draw, mean, least) in kinds {
            for count in [10, 20, 50] {
                let held = share(RUNS, || {
                    let values: Vec<f64> = (0..count).map(|_| draw(&mut random)).collect();
                    let found = mean_interval(values.into_iter()).unwrap();
                    contains(found.interval.unwrap(), mean)
                });
                println!("{name}, {count} values: {:.1} %", 100.0 * held);
                assert!(
                    (least..0.9999).contains(&held),
                    "{name}, {count} values: {held}"
                );
            }
        }
    }

    fn normal(random: &mut Rng) -> f64 {
        let length = (-2.0 * (1.0 - random.f64()).ln()).sqrt();
        length * (std::f64::consts::TAU * random.f64()).cos()
    }

    #[test]
    fn means_of_many_values_and_of_values_that_are_alike_have_intervals() {
        let mut random = Rng::with_seed(7);
        // Of many values, 2.24 / sqrt(12 n) to either side.
        let found = mean_interval((0..200_000).map(|_| random.f64())).unwrap();
        let width = found.interval.unwrap().width() / (2.0 * 2.24 / (12.0 * 200_000_f64).sqrt());
        assert!((0.9..1.1).contains(&width) && (found.mean - 0.5).abs() < 3e-3);
        // Values that repeat block by block are drawn like any others.
        let found = mean_interval((0..4000).map(|i| f64::from(i % 2))).unwrap();
        let width = found.interval.unwrap().width() / (2.0 * 2.24 * 0.5 / 4000_f64.sqrt());
        assert!((0.9..1.1).contains(&width), "{width}");
        assert_eq!(mean_interval([1.0; 9].into_iter()), None);
        for (ones, differing) in [(10, 0), (0, 0), (5, 5), (9, 1)] {
            let values = (0..10).map(|i| f64::from(u8::from(i < ones)));
            let found = mean_interval(values).unwrap();
            assert_eq!((found.differing, found.count), (differing, 10));
            assert_eq!(found.interval.is_some(), differing >= DIFFERING_LEAST);
            let width = found.interval.map(Interval::width);
            assert!(width.is_none_or(|width| width > 0.0 && width.is_finite()));
        }
    }

    /// Prints how often the interval holds if at least so many values must differ, and how often there is one, if it is
    /// built for release.
    #[test]
    fn coverage_of_the_intervals_of_means_of_which_many_are_alike() {
        const RUNS: usize = if cfg!(debug_assertions) { 200 } else { 4000 };
        // Where one campaign in so many has an interval; of 50 runs, 4 standard deviations are 15 %.
        const SHOWN: usize = if cfg!(debug_assertions) { 4 } else { 10 };
        const LEAST: f64 = if cfg!(debug_assertions) { 0.77 } else { 0.91 };
        type Draw = fn(&mut Rng) -> f64;
        let kinds: [(&str, Draw, f64); 4] = [
            ("one", |_| 1.0, 1.0),
            ("exponential", |random| -(1.0 - random.f64()).ln(), 1.0),
            ("lognormal", |random| normal(random).exp(), 0.5_f64.exp()),
            ("normal", normal, 0.0),
        ];
        let mut random = Rng::with_seed(7);
        for (name, draw, mean) in kinds {
            for not_zero in [0.05, 0.2, 0.5] {
                for count in [10, 20, 50] {
                    let mut value = || match random.f64() < not_zero {
                        true => draw(&mut random),
                        false => 0.0,
                    };
                    let runs = (0..RUNS).map(|_| {
                        let values: Vec<f64> = (0..count).map(|_| value()).collect();
                        let differing = count as u64 - most_frequent(&values);
                        let holds =
                            || contains(bootstrap_t(values.clone()).unwrap(), not_zero * mean);
                        (differing, differing > 1 && holds())
                    });
                    let runs: Vec<(u64, bool)> = runs.collect();
                    let covered = |least: u64| {
                        let shown = runs.iter().filter(|(differing, _)| *differing >= least);
                        let held = shown.clone().filter(|(_, holds)| *holds).count();
                        (held as f64 / shown.clone().count() as f64, shown.count())
                    };
                    let shares = [0, 2, 4, 6, 8].map(|least| {
                        let (held, shown) = covered(least);
                        let shown = 100.0 * shown as f64 / RUNS as f64;
                        format!("{least}: {:.1} % in {shown:.0} %", 100.0 * held)
                    });
                    let said = format!(
                        "{name}, {not_zero} not 0, {count} values: {}",
                        shares.join(", ")
                    );
                    println!("{said}");
                    let (held, shown) = covered(DIFFERING_LEAST);
                    assert!(shown < RUNS / SHOWN || held >= LEAST, "{said}");
                }
            }
        }
    }

    #[test]
    fn a_difference_beyond_the_spread_is_found_among_kinds_without_one() {
        let mut random = Rng::with_seed(3);
        let mut group = |mean: f64| (0..4).map(|_| mean + random.f64()).collect::<Vec<_>>();
        let means = (0..41).map(|i| if i < 40 { 10.0 } else { 30.0 });
        let kinds = means.map(|mean| groups(&group(10.0), &group(mean)));
        let found = permutation_test(&kinds.collect::<Vec<_>>());
        // Two of the 70 ways to deal 4 of 8 set them as far apart.
        assert_eq!(found[40], Some(2.0 / 70.0));
        let mut others = found[..40].iter();
        assert!(others.all(|probability| probability.unwrap() > 0.05));
    }
}
