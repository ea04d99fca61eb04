//! The mean of paired differences, with its interval by the bootstrap.
//!
//! Efron, Tibshirani, "An Introduction to the Bootstrap" (1993), chapter 13: percentiles of the means of resamples.

use fastrand::Rng;
use serde::Serialize;

/// Resamples: their 25th from either end is where the interval ends.
const RESAMPLES: usize = 1000;
/// Values that are resampled at the most: more are taken together in blocks, which flights that know nothing of each
/// other allow.
const BLOCKS: usize = 2000;

/// A mean and where it may be, at 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanInterval {
    /// Values.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

/// The mean of some values, of which NaN is none; none of fewer than ten values.
#[must_use]
pub fn mean_interval(values: impl Iterator<Item = f64>) -> Option<MeanInterval> {
    let values: Vec<f64> = values.filter(|value| !value.is_nan()).collect();
    if values.len() < 10 {
        return None;
    }
    let blocks = values.len().min(BLOCKS);
    let cut = |block: usize| block * values.len() / blocks;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let blocked: Vec<f64> = (0..blocks).map(|block| mean(&values[cut(block)..cut(block + 1)])).collect();
    // The same campaign has the same report.
    let mut rng = Rng::with_seed(1);
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| (0..blocks).map(|_| blocked[rng.usize(..blocks)]).sum::<f64>() / blocks as f64)
        .collect();
    means.sort_unstable_by(f64::total_cmp);
    let beyond = RESAMPLES / 40;
    Some(MeanInterval {
        count: values.len() as u64,
        mean: mean(&values),
        low: means[beyond - 1],
        high: means[RESAMPLES - beyond],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_holds_the_mean_about_as_often_as_it_says() {
        let mut rng = Rng::with_seed(7);
        let held = (0..400).filter(|_| {
            let values: Vec<f64> = (0..60).map(|_| rng.f64() + rng.f64()).collect();
            mean_interval(values.into_iter()).is_some_and(|it| it.low <= 1.0 && 1.0 <= it.high)
        });
        let held = held.count();
        assert!((360..=395).contains(&held), "{held} of 400");
    }

    #[test]
    fn many_values_are_as_quick_and_no_less_exact() {
        let mut rng = Rng::with_seed(7);
        let values: Vec<f64> = (0..200_000).map(|_| rng.f64()).collect();
        let interval = mean_interval(values.into_iter()).unwrap();
        // 1.96 / sqrt(12 n) to either side.
        let width = (interval.high - interval.low) / (2.0 * 1.96 / (12.0 * 200_000_f64).sqrt());
        assert!((0.9..1.1).contains(&width) && (interval.mean - 0.5).abs() < 3e-3, "{interval:?}");
        assert_eq!(mean_interval([1.0; 9].into_iter()), None);
    }
}
