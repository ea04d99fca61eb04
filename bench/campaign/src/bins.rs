//! Which factor matters: flights in bins by what they drew, compared.

use analysis::statistics::{Interval, wilson};
use serde::Serialize;

pub const BINS_MAX: usize = 10;
const BIN_FLIGHTS: usize = 20;

#[derive(Clone, Debug, PartialEq)]
pub struct Bins {
    pub of: Vec<u32>,
    pub names: Vec<String>,
    pub ranges: Vec<[f64; 2]>,
}

impl Bins {
    /// Of numbers: bins of as many flights each, `most` at the most, where equal numbers are always in one bin.
    pub fn of_numbers(values: &[f64], most: usize) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let mut cuts = sorted.clone();
        cuts.dedup();
        let count = (values.len() / BIN_FLIGHTS).clamp(2, most.max(2));
        if cuts.len() > most {
            let cut = |bin| sorted[bin * sorted.len() / count];
            cuts = (0..count).map(cut).collect();
            cuts.dedup();
        }
        let bin = |value| cuts.partition_point(|cut| cut <= value).max(1) - 1;
        let of: Vec<u32> = values.iter().map(|value| bin(value) as u32).collect();
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; cuts.len()];
        for (value, bin) in values.iter().zip(&of) {
            let range = &mut ranges[*bin as usize];
            *range = [range[0].min(*value), range[1].max(*value)];
        }
        let name = |range: &[f64; 2]| match range {
            [low, high] if low == high => short(*low),
            [low, high] => format!("{} to {}", short(*low), short(*high)),
        };
        Self {
            names: ranges.iter().map(name).collect(),
            of,
            ranges,
        }
    }
}

pub fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    if !(1e-4..1e6).contains(&value.abs()) {
        return format!("{value:.2e}");
    }
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bin {
    pub name: String,
    pub range: Option<[f64; 2]>,
    pub flights: u64,
    pub successes: u64,
    pub interval: Interval,
}

pub fn success(bins: &Bins, success: &[bool]) -> Vec<Bin> {
    let mut counts = vec![[0; 2]; bins.names.len()];
    for (bin, success) in bins.of.iter().zip(success) {
        if let Some([flights, successes]) = counts.get_mut(*bin as usize) {
            *flights += 1;
            *successes += u64::from(*success);
        }
    }
    let bin = |(i, [flights, successes]): (usize, [u64; 2])| Bin {
        name: bins.names[i].clone(),
        range: bins.ranges.get(i).copied(),
        flights,
        successes,
        interval: wilson(successes, flights),
    };
    counts.into_iter().enumerate().map(bin).collect()
}

/// Share of the variance of some values that the bins account for, less what they would by chance (omega squared);
/// none where the values are all alike, or there are not two bins. NaN is no value.
pub fn explained(bins: &Bins, values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sums = vec![(0.0_f64, 0.0_f64); bins.names.len()];
    let (mut n, mut mean, mut squares) = (0.0_f64, 0.0_f64, 0.0_f64);
    let known = bins.of.iter().zip(values);
    for (bin, value) in known.filter(|(_, value)| value.is_finite()) {
        n += 1.0;
        let off = value - mean;
        mean += off / n;
        squares += off * (value - mean);
        if let Some((count, sum)) = sums.get_mut(*bin as usize) {
            *count += 1.0;
            *sum += value;
        }
    }
    let used: Vec<(f64, f64)> = sums.into_iter().filter(|(count, _)| *count > 0.0).collect();
    let groups = used.len() as f64;
    if used.len() < 2 || n <= groups || squares <= 0.0 {
        return None;
    }
    let square = |(count, sum): &(f64, f64)| count * (sum / count - mean) * (sum / count - mean);
    let between: f64 = used.iter().map(square).sum();
    let within = ((squares - between) / (n - groups)).max(0.0);
    Some(((between - (groups - 1.0) * within) / (squares + within)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use fastrand::Rng;

    use super::*;

    #[test]
    fn bins_have_as_many_flights_each_and_equal_numbers_stay_together() {
        let values: Vec<f64> = (0..400).map(|i| f64::from(i * 7 % 400)).collect();
        let bins = Bins::of_numbers(&values, 10);
        assert_eq!(
            (bins.names.len(), bins.ranges[0], bins.names[9].as_str()),
            (10, [0.0, 39.0], "360 to 399")
        );
        let is_low: Vec<bool> = values.iter().map(|value| *value < 60.0).collect();
        let counted = success(&bins, &is_low);
        assert!(counted.iter().all(|bin| bin.flights == 40));
        let successes: Vec<u64> = counted.iter().map(|bin| bin.successes).collect();
        assert_eq!(successes, [40, 20, 0, 0, 0, 0, 0, 0, 0, 0]);
        let few = Bins::of_numbers(&[0.5, 0.25, 0.5, 1e-7, 0.5], 10);
        assert_eq!(few.of, [2, 1, 2, 0, 2]);
        assert_eq!(few.names, ["1.00e-7", "0.25", "0.5"]);
    }

    #[test]
    fn a_factor_without_effect_explains_nothing() {
        let mut rng = Rng::with_seed(7);
        let drawn: Vec<[f64; 2]> = (0..2000).map(|_| [rng.f64(), rng.f64()]).collect();
        let outcome = || drawn.iter().map(|it| f64::from(u8::from(it[0] < 0.3)));
        let of = |i: usize| {
            let values: Vec<f64> = drawn.iter().map(|it| it[i]).collect();
            Bins::of_numbers(&values, BINS_MAX)
        };
        let shares = [0, 1].map(|i| explained(&of(i), outcome()).unwrap());
        assert!(shares[0] > 0.95 && shares[1] < 0.01, "{shares:?}");
        // What is always alike has no causes.
        assert_eq!(explained(&of(0), drawn.iter().map(|_| 1.0)), None);
    }
}
