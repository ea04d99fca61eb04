//! Noise of the sensors and of the air: standard normal variates as a function of (seed, tick, stream, axis).
//!
//! This goes beyond the paper, whose sensors are exact and whose air is still. [`messages::noise`] makes the variates.

use messages::noise::standard_normal;
use nalgebra::Vector3;

/// What a variate is drawn for; each has its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    Gyro,
    GyroDrift,
    Accelerometer,
    Position,
    Velocity,
    Gust,
    FilteredGust,
}

impl Stream {
    /// Three independent standard normal variates, for x, y, z.
    pub fn normal(self, seed: u64, tick: u64) -> Vector3<f64> {
        let first = 3 * self as u64;
        Vector3::from_fn(|axis, _| standard_normal(seed, tick, first + axis as u64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_standard_normal_and_independent() {
        const TICKS: u64 = 100_000;
        for seed in [0, 1, u64::MAX] {
            let samples: Vec<[f64; 3]> = (0..TICKS)
                .map(|tick| [0, 1, 2].map(|axis| standard_normal(seed, tick, axis)))
                .collect();
            let mean = |product: &dyn Fn(usize) -> f64| {
                (0..samples.len() - 1).map(product).sum::<f64>() / (samples.len() - 1) as f64
            };
            // Standard errors of these means: 0.0032, 0.0045, 0.0032, and 0.031 of the fourth moment.
            for axis in 0..3 {
                let moment = |power| mean(&|i| samples[i][axis].powi(power));
                let next_tick = mean(&|i| samples[i][axis] * samples[i + 1][axis]);
                let next_axis = mean(&|i| samples[i][axis] * samples[i][(axis + 1) % 3]);
                for (what, value, bound) in [
                    ("mean", moment(1), 0.016),
                    ("variance less 1", moment(2) - 1.0, 0.022),
                    ("fourth moment less 3", moment(4) - 3.0, 0.16),
                    ("correlation in time", next_tick, 0.016),
                    ("correlation with the next axis", next_axis, 0.016),
                ] {
                    assert!(
                        value.abs() < bound,
                        "seed {seed}, axis {axis}: {what} {value}"
                    );
                }
            }
        }
    }

    #[test]
    fn every_stream_has_its_own_samples() {
        use Stream::{Accelerometer, FilteredGust, Gust, Gyro, GyroDrift, Position, Velocity};
        let drawn: Vec<f64> = [
            Gyro,
            GyroDrift,
            Accelerometer,
            Position,
            Velocity,
            Gust,
            FilteredGust,
        ]
        .iter()
        .flat_map(|stream| <[f64; 3]>::from(stream.normal(7, 5)))
        .collect();
        for (i, sample) in drawn.iter().enumerate() {
            assert!(!drawn[..i].contains(sample), "{i}: {drawn:?}");
        }
    }
}
