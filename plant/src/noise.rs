//! Noise of the sensors: standard normal variates as a function of (seed, tick, stream, axis).
//!
//! This goes beyond the paper, whose sensors are exact. [`messages::noise`] makes the variates.

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
                assert!(
                    moment(1).abs() < 0.016,
                    "seed {seed}, axis {axis}: mean {}",
                    moment(1)
                );
                assert!(
                    (moment(2) - 1.0).abs() < 0.022,
                    "seed {seed}, axis {axis}: variance {}",
                    moment(2)
                );
                assert!(
                    (moment(4) - 3.0).abs() < 0.16,
                    "seed {seed}, axis {axis}: fourth moment {}",
                    moment(4)
                );
                let next_tick = mean(&|i| samples[i][axis] * samples[i + 1][axis]);
                assert!(
                    next_tick.abs() < 0.016,
                    "seed {seed}, axis {axis}: correlated in time {next_tick}"
                );
                let next_axis = mean(&|i| samples[i][axis] * samples[i][(axis + 1) % 3]);
                assert!(
                    next_axis.abs() < 0.016,
                    "seed {seed}, axis {axis}: correlated with the next {next_axis}"
                );
            }
        }
    }

    #[test]
    fn every_stream_has_its_own_samples() {
        use Stream::{Accelerometer, Gyro, GyroDrift, Position, Velocity};
        let drawn: Vec<f64> = [Gyro, GyroDrift, Accelerometer, Position, Velocity]
            .iter()
            .flat_map(|stream| <[f64; 3]>::from(stream.normal(7, 5)))
            .collect();
        for (i, sample) in drawn.iter().enumerate() {
            assert!(!drawn[..i].contains(sample), "{i}: {drawn:?}");
        }
    }
}
