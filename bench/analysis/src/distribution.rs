//! Distribution of a latency series: percentile curve, histogram, confidence intervals.

use crate::series::{Latencies, SLACK};
use crate::statistics::ranks;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

pub const P999_COUNT: u64 = 10_000;
pub const P9999_COUNT: u64 = 100_000;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bucket {
    pub from_us: f64,
    pub below_us: f64,
    pub count: u64,
}

/// Points of the curve per halving of the distance to 100 %.
const CURVE_STEPS: u32 = 4;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distribution {
    pub name: String,
    /// Percentiles that the number of values allows, with their intervals.
    pub percentiles: Vec<Percentile>,
    /// Share of the values, and the value that this share does not exceed [us]. The largest of n values stands at
    /// 1 - 1/2n.
    pub curve: Vec<(f64, f64)>,
    /// The histogram: every value is in one bin, and empty bins are left out. Around 0, or around the length of a tick
    /// where the series is a period, bins are as narrow as three digits allow; far from it there are 24 a decade. There
    /// are at most 220 up to 10 s.
    pub bins: Vec<Bin>,
}

/// Bins of a histogram per decade of the distance from its middle.
const BINS_PER_DECADE: f64 = 24.0;

/// A bin of a histogram: from [us], below [us], how many values.
pub type Bin = (f64, f64, u64);

/// A percentile with its interval ([`crate::statistics::CONFIDENCE`]), which supposes that values are independent of
/// each other and nothing about their distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Percentile {
    pub percent: f64,
    pub value_us: f64,
    pub low_us: f64,
    pub high_us: f64,
}

/// The percentiles of a latency in the report, with the number of values that each needs.
pub const PERCENTS: [(f64, u64); 5] = [
    (50.0, 0),
    (90.0, 0),
    (99.0, 0),
    (99.9, P999_COUNT),
    (99.99, P9999_COUNT),
];

/// The percentiles of a series on the side of its tail that matters.
pub fn tail_percents(name: &str) -> [f64; PERCENTS.len()] {
    match name {
        SLACK => [50.0, 10.0, 1.0, 0.1, 0.01],
        _ => PERCENTS.map(|(percent, _)| percent),
    }
}

impl Distribution {
    /// The distribution of latencies whose bins are finest around `about_ns`: the tick's length for a period, 0 for
    /// other latencies.
    pub fn of(name: &str, latencies: &Latencies, about_ns: u64) -> Self {
        let percents = tail_percents(name).into_iter().zip(PERCENTS);
        let allowed = percents.filter(|(_, (_, needed))| latencies.len() >= *needed);
        let percentiles = allowed.filter_map(|(percent, _)| percentile(latencies, percent));
        Self {
            name: name.to_owned(),
            percentiles: percentiles.collect(),
            curve: curve(latencies),
            bins: Bins::about(latencies, about_ns).of(latencies),
        }
    }

    /// A percentile of the report; none where there are too few values.
    pub fn percentile(&self, percent: f64) -> Option<&Percentile> {
        self.percentiles.iter().find(|it| it.percent == percent)
    }
}

fn in_us(ns: u64) -> f64 {
    ns as f64 / 1e3
}

fn percentile(latencies: &Latencies, percent: f64) -> Option<Percentile> {
    let count = latencies.len();
    let (low, high) = ranks(count, percent / 100.0)?;
    // In the middle of the rank's share, where rounding cannot reach the next one.
    let at_rank = |rank: u64| latencies.quantile_ns((rank as f64 - 0.5) / count as f64);
    Some(Percentile {
        percent,
        value_us: in_us(latencies.quantile_ns(percent / 100.0)),
        low_us: in_us(latencies.lowest_equivalent(at_rank(low))),
        high_us: in_us(at_rank(high)),
    })
}

fn curve(latencies: &Latencies) -> Vec<(f64, f64)> {
    if latencies.is_empty() {
        return Vec::new();
    }
    let largest = 1.0 - 0.5 / latencies.len() as f64;
    let steps = latencies.iter_quantiles(CURVE_STEPS);
    let points = steps.map(|step| (step.quantile_iterated_to(), in_us(step.value_iterated_to())));
    // The last steps lie closer to 100 % than one value is.
    let points = points.filter(|(share, _)| *share < largest);
    points
        .chain([(largest, in_us(latencies.max_ns()))])
        .collect()
}

/// A logarithmic histogram: three bars a decade.
pub fn buckets(latencies: &Latencies) -> Vec<Bucket> {
    let steps = |decade| [1, 2, 5].map(|step| step * 10_u64.pow(decade));
    let edges: Vec<u64> = [0].into_iter().chain((2..=18).flat_map(steps)).collect();
    let bucket = |edges: &[u64]| {
        let values = latencies.iter_recorded();
        let inside = values.filter(|it| (edges[0]..edges[1]).contains(&it.value_iterated_to()));
        Bucket {
            from_us: in_us(edges[0]),
            below_us: in_us(edges[1]),
            count: inside.map(|it| it.count_at_value()).sum(),
        }
    };
    let buckets = edges.windows(2).map(bucket);
    buckets.filter(|bucket| bucket.count > 0).collect()
}

/// How values are sorted into bins: equal steps of ln(1 + d / threshold), where d is the distance from the middle. Up
/// to the threshold bins are of about equal width, beyond it of equal ratio.
struct Bins {
    about_ns: u64,
    threshold_ns: f64,
}

impl Bins {
    /// Bins no narrower than two steps of the histogram are wide: narrower ones would be empty in turns.
    fn about(latencies: &Latencies, about_ns: u64) -> Self {
        Self {
            about_ns,
            threshold_ns: 2.0 * latencies.equivalent_range(about_ns) as f64 / Self::STEP,
        }
    }

    const STEP: f64 = std::f64::consts::LN_10 / BINS_PER_DECADE;

    /// Number of the bin of a value; below the middle it is negative.
    fn number(&self, ns: u64) -> i64 {
        let distance_ns = ns as f64 - self.about_ns as f64;
        let steps = (distance_ns.abs() / self.threshold_ns).ln_1p() / Self::STEP;
        (steps * distance_ns.signum()).floor() as i64
    }

    fn begin_us(&self, number: i64) -> f64 {
        let distance_ns = self.threshold_ns * (Self::STEP * number.abs() as f64).exp_m1();
        let begin_ns = self.about_ns as f64 + distance_ns * number.signum() as f64;
        begin_ns.round() / 1e3
    }

    fn of(&self, latencies: &Latencies) -> Vec<Bin> {
        let mut counts: BTreeMap<i64, u64> = BTreeMap::new();
        for value in latencies.iter_recorded() {
            let number = self.number(value.value_iterated_to());
            *counts.entry(number).or_default() += value.count_at_value();
        }
        let bin = |(number, count)| (self.begin_us(number), self.begin_us(number + 1), count);
        counts.into_iter().map(bin).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn histogram(values: impl Iterator<Item = u64>) -> Latencies {
        let mut latencies = Latencies::new().unwrap();
        values.for_each(|value| latencies.record(value));
        latencies
    }

    #[test]
    fn percentiles_need_enough_values() {
        // The largest of n values is above the median with a probability of 1 - 2^-n.
        let few = [(5, 0), (6, 1), (P999_COUNT - 1, 3)];
        for (count, allowed) in few.into_iter().chain([(P999_COUNT, 4), (P9999_COUNT, 5)]) {
            let distribution = Distribution::of("loop", &histogram(1..=count), 0);
            let percents = distribution.percentiles.iter().map(|it| it.percent);
            let expected = PERCENTS.into_iter().take(allowed).map(|it| it.0);
            assert!(percents.eq(expected), "{count}");
        }
    }

    #[test]
    fn bins_hold_every_value_follow_each_other_and_are_finest_around_their_middle() {
        for (about_ns, every_ns) in [(0, 1), (1_000_000, 700)] {
            let values = (1..=20_000_u64).map(|i| i * every_ns);
            let bins = Distribution::of("period", &histogram(values), about_ns).bins;
            assert_eq!(bins.iter().map(|bin| bin.2).sum::<u64>(), 20_000);
            assert!(bins.iter().all(|bin| bin.0 < bin.1));
            // None of these is empty.
            assert!(bins.is_sorted_by(|a, b| a.1 == b.0));
        }
        let period_ns = [985_000, 999_500, 1_000_500, 1_015_000, 101_000_000];
        let bins = Distribution::of("period", &histogram(period_ns.into_iter()), 1_000_000).bins;
        assert!(bins.len() == 5 && bins.iter().all(|bin| bin.2 == 1));
        let width = |i: usize| bins[i].1 - bins[i].0;
        let is_finest = width(1) < 1.1 && width(3) < 4.0 && width(4) > 5_000.0;
        assert!(is_finest && bins[1].1 == 1_000.0, "{bins:?}");
        const LONG_NS: u64 = 10_000_000_000;
        let widest = histogram([1, LONG_NS].into_iter());
        for about_ns in [0, 1_000_000, 10_000_000] {
            let bins = Bins::about(&widest, about_ns);
            let count = bins.number(LONG_NS) - bins.number(1) + 1;
            assert!(count <= 220, "{count} around {about_ns} ns");
        }
    }
}
