//! The empirical distribution of a metric, with its tail.

use serde::Serialize;

/// Shares whose quantiles are given, as far as there are enough values.
const SHARES: [f64; 7] = [0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 0.9999];

/// A share of the flights with the smallest value that so many do not exceed; none where it falls on flights without a
/// value, which are above all that have one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantile {
    pub share: f64,
    pub value: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Distribution {
    /// Flights with a value: the mean is theirs.
    pub count: u64,
    /// Flights without one, because they did not recover: in all but the mean, they are above every value.
    pub missing: u64,
    pub mean: Option<f64>,
    pub min: Option<f64>,
    pub max: Option<f64>,
    /// Of the shares that at least ten flights lie beyond, on either side.
    pub quantiles: Vec<Quantile>,
    pub curve: Vec<Quantile>,
}

/// The distribution of the values of flights; NaN is none.
pub fn distribution(values: impl Iterator<Item = f64>) -> Distribution {
    let (missing, mut sorted): (Vec<f64>, Vec<f64>) = values.partition(|value| value.is_nan());
    sorted.sort_unstable_by(f64::total_cmp);
    let (count, n) = (sorted.len(), sorted.len() + missing.len());
    if n == 0 {
        return Distribution::default();
    }
    let at = |share: f64| Quantile {
        share,
        value: sorted
            .get(((share * n as f64).ceil() as usize).clamp(1, n) - 1)
            .copied(),
    };
    // Rounding must not cost one of exactly ten values: 1000 * (1 - 0.99) is 10.000000000000009, or less.
    let is_known = |share: &f64| n as f64 * share.min(1.0 - share) >= 10.0 - 1e-6 || *share == 0.5;
    // As dense in the tail as before it: each nine takes as many points.
    let nines = (0..).flat_map(|nine| {
        (0..20).map(move |i| 1.0 - 10_f64.powi(-nine) * (1.0 - 0.045 * f64::from(i)))
    });
    let last = 1.0 - 1.0 / n as f64;
    let mut curve: Vec<Quantile> = nines.take_while(|share| *share < last).map(at).collect();
    curve.push(Quantile {
        share: last,
        value: at(1.0).value,
    });
    Distribution {
        count: count as u64,
        missing: missing.len() as u64,
        mean: (count > 0).then(|| sorted.iter().sum::<f64>() / count as f64),
        min: sorted.first().copied(),
        max: at(1.0).value,
        quantiles: SHARES.into_iter().filter(is_known).map(at).collect(),
        curve,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_given_as_far_as_there_are_values() {
        let known = distribution((1..=1000).rev().map(f64::from));
        assert_eq!(
            (known.count, known.missing, known.min, known.max, known.mean),
            (1000, 0, Some(1.0), Some(1000.0), Some(500.5))
        );
        let values = |it: &Distribution| -> Vec<(f64, Option<f64>)> {
            let quantiles = it.quantiles.iter();
            quantiles.map(|it| (it.share, it.value)).collect()
        };
        let expected = [
            (0.01, 10.0),
            (0.1, 100.0),
            (0.5, 500.0),
            (0.9, 900.0),
            (0.99, 990.0),
        ];
        assert_eq!(
            values(&known),
            expected.map(|(share, value)| (share, Some(value)))
        );
        let rises = |a: &Quantile, b: &Quantile| a.share < b.share && a.value <= b.value;
        assert!(known.curve.is_sorted_by(rises), "{:?}", known.curve);
        let at = |share, value| Quantile {
            share,
            value: Some(value),
        };
        // Flights without a value are above all others.
        let missing = distribution((1..=20).map(f64::from).chain([f64::NAN; 80]));
        assert_eq!(
            (missing.count, missing.missing, missing.max, missing.mean),
            (20, 80, None, Some(10.5))
        );
        let expected = [(0.1, Some(10.0)), (0.5, None), (0.9, None)];
        assert_eq!(values(&missing), expected);
        assert_eq!(missing.curve.last().unwrap().value, None);
        let none = distribution([f64::NAN; 3].into_iter());
        assert_eq!((none.count, none.missing, none.mean), (0, 3, None));
        assert_eq!(known.curve.last(), Some(&at(0.999, 1000.0)));
        let shares = |count: u32| {
            let quantiles = distribution((0..count).map(f64::from)).quantiles;
            quantiles.iter().map(|it| it.share).collect::<Vec<_>>()
        };
        assert_eq!(shares(999), [0.1, 0.5, 0.9]);
        assert_eq!(shares(99), [0.5]);
        assert_eq!(shares(100), [0.1, 0.5, 0.9]);
        assert_eq!(shares(10_000).last(), Some(&0.999));
        assert_eq!(distribution(std::iter::empty()), Distribution::default());
        assert_eq!(distribution([3.0].into_iter()).curve, [at(0.0, 3.0)]);
    }
}
