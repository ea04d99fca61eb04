//! Rates of success with their intervals at 95 %, and tests of pairs.
//!
//! Wilson, "Probable inference" (1927); Clopper and Pearson, "The use of confidence or fiducial limits" (1934);
//! McNemar, "Note on the sampling error of the difference between correlated proportions" (1947), in its exact form.

use serde::Serialize;
use statrs::function::erf::erfc;

use super::beta::beta_share;
use super::bootstrap::MeanInterval;

/// Two-sided 95 % of a standard normal.
const Z: f64 = 1.959_963_984_540_054;
/// Share outside of an interval.
const ALPHA: f64 = 0.05;

/// An interval of a rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RateInterval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

impl RateInterval {
    /// How far it reaches.
    #[must_use]
    pub fn width(self) -> f64 {
        self.high - self.low
    }
}

/// Wilson's score interval of `hits` of `trials`: the whole range without a trial.
#[must_use]
pub fn wilson(hits: u64, trials: u64) -> RateInterval {
    if trials == 0 {
        return RateInterval { low: 0.0, high: 1.0 };
    }
    let (n, rate) = (trials as f64, hits as f64 / trials as f64);
    let spread = 1.0 + Z * Z / n;
    let middle = (rate + Z * Z / (2.0 * n)) / spread;
    let half = Z / spread * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    // At the ends it touches them, which rounding might miss.
    let low = if hits == 0 { 0.0 } else { (middle - half).max(0.0) };
    let high = if hits == trials { 1.0 } else { (middle + half).min(1.0) };
    RateInterval { low, high }
}

/// Clopper and Pearson's exact interval: never less than 95 % of the time does it hold the true rate.
#[must_use]
pub fn clopper_pearson(hits: u64, trials: u64) -> RateInterval {
    if trials == 0 {
        return RateInterval { low: 0.0, high: 1.0 };
    }
    let (k, n) = (hits as f64, trials as f64);
    // Where all or none are hits the incomplete beta function is a power.
    let extreme = (ALPHA / 2.0).powf(1.0 / n);
    let low = match hits {
        0 => 0.0,
        _ if hits == trials => extreme,
        _ => solve(|rate| beta_share(k, n - k + 1.0, rate), ALPHA / 2.0),
    };
    let high = match hits {
        0 => 1.0 - extreme,
        _ if hits == trials => 1.0,
        _ => solve(|rate| beta_share(k + 1.0, n - k, rate), 1.0 - ALPHA / 2.0),
    };
    RateInterval { low, high }
}

/// Where a function that rises from 0 to 1 over the same range has a value: by bisection, which always ends.
fn solve(rising: impl Fn(f64) -> f64, value: f64) -> f64 {
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for _ in 0..200 {
        let middle = (low + high) / 2.0;
        if rising(middle) < value {
            low = middle;
        } else {
            high = middle;
        }
    }
    (low + high) / 2.0
}

/// Pairs of flights that differ in their success.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Discordant {
    /// The first alone was a success.
    pub first: u64,
    /// The second alone.
    pub second: u64,
}

impl Discordant {
    /// How probable a split at least as uneven is, were both alike: McNemar's test, exact up to 10 000 pairs.
    #[must_use]
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
        (2.0 * beta_share((pairs - fewer) as f64, fewer as f64 + 1.0, 0.5)).min(1.0)
    }

    /// Difference of the success rates, first less second, over all pairs, with its interval (Wald's, of pairs).
    #[must_use]
    pub fn difference(self, pairs: u64) -> MeanInterval {
        let (n, first, second) = (pairs.max(1) as f64, self.first as f64, self.second as f64);
        let difference = (first - second) / n;
        let deviation = ((first + second) / n - difference * difference).max(0.0).sqrt() / n.sqrt();
        let [low, high] = [difference - Z * deviation, difference + Z * deviation];
        MeanInterval { count: pairs, mean: difference, low: low.max(-1.0), high: high.min(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(interval: RateInterval, low: f64, high: f64) {
        let off = (interval.low - low).abs().max((interval.high - high).abs());
        assert!(off <= 6e-3 * high.min(1.0 - low).max(1e-12), "{interval:?}, expected {low}..{high}");
    }

    #[test]
    fn intervals_are_those_of_the_tables() {
        // statsmodels.stats.proportion.proportion_confint, methods "wilson" and "beta".
        close(wilson(8, 10), 0.490_162, 0.943_318);
        close(clopper_pearson(8, 10), 0.443_905, 0.974_789);
        close(clopper_pearson(3, 10_000), 6.187e-5, 8.764_6e-4);
        close(wilson(3, 10_000), 1.020_3e-4, 8.817e-4);
        // The rule of three, with 3.69 for 97.5 %.
        close(clopper_pearson(0, 10_000), 0.0, 3.688e-4);
        assert_eq!((wilson(0, 9).low, wilson(9, 9).high, clopper_pearson(9, 9).high), (0.0, 1.0, 1.0));
        assert_eq!(wilson(0, 0), RateInterval { low: 0.0, high: 1.0 });
    }

    #[test]
    fn large_campaigns_have_an_answer() {
        for trials in [1_000_000, 10_000_000, 100_000_000] {
            for hits in [0, 1, trials / 2, trials - 1, trials] {
                let exact = clopper_pearson(hits, trials);
                let rate = hits as f64 / trials as f64;
                assert!(
                    exact.low <= rate && rate <= exact.high && exact.width() < 3e-3,
                    "{hits} of {trials}: {exact:?}"
                );
            }
        }
        close(clopper_pearson(0, 1_000_000), 0.0, 3.689e-6);
    }

    #[test]
    fn an_exact_interval_holds_the_rate_as_often_as_it_says() {
        let (trials, rate) = (40_u64, 0.9_f64);
        let mut covered = 0.0;
        let mut probability = (1.0 - rate).powi(trials as i32);
        for hits in 0..=trials {
            let interval = clopper_pearson(hits, trials);
            if (interval.low..=interval.high).contains(&rate) {
                covered += probability;
            }
            probability *= rate / (1.0 - rate) * (trials - hits) as f64 / (hits + 1) as f64;
        }
        assert!((0.95..0.99).contains(&covered), "{covered}");
    }

    #[test]
    fn uneven_pairs_are_improbable() {
        let p = |first, second| Discordant { first, second }.p_value();
        assert_eq!((p(0, 0), p(5, 5)), (1.0, 1.0));
        // 2 * (1 + 10) / 1024 and 2 / 1024.
        assert!((p(1, 9) - 22.0 / 1024.0).abs() < 1e-12 && (p(10, 0) - 2.0 / 1024.0).abs() < 1e-12);
        let (exact, asymptotic) = (p(5100, 4900), p(5101, 4901));
        assert!((exact / asymptotic - 1.0).abs() < 0.05, "{exact} {asymptotic}");
        let MeanInterval { mean, low, high, .. } = Discordant { first: 30, second: 10 }.difference(200);
        assert!((mean - 0.1).abs() < 1e-12 && low > 0.03 && high < 0.17, "{low} {high}");
    }
}
