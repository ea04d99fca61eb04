//! What a factor may be drawn from, and the value that a flight draws.

use messages::math;
use toml::Value;

use crate::generator::Stream;
use crate::spread::{latin, sobol};

/// What a factor is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    /// The same value in every flight.
    Fixed(Value),
    /// One of these, each as likely as the others.
    Choice(Vec<Value>),
    /// All combinations of all grids in turn; in the campaign's grids, the value changes every `stride` flights.
    Grid {
        values: Vec<Value>,
        /// Cells of the grids that come after it.
        stride: u64,
    },
    /// From low to high, all alike.
    Uniform([f64; 2]),
    /// Normal, by mean and standard deviation; draws beyond the bounds are drawn again.
    Normal {
        mean: f64,
        deviation: f64,
        /// What a draw must be within, where that is given.
        within: Option<[f64; 2]>,
    },
    /// From low to high, all ratios alike.
    LogUniform([f64; 2]),
    /// From low to high, with one flight in each of as many strata as there are flights.
    Latin { range: [f64; 2], flights: u64 },
    /// From low to high, by a dimension of Sobol's sequence.
    Sobol { range: [f64; 2], dimension: usize },
    /// A whole number from 0 to below 2^53, which every format keeps exactly.
    Seed,
}

/// Draws of a truncated normal distribution at the most: [`Distribution::is_likely`] makes sure that they are enough.
const ATTEMPTS: u32 = 10_000;

impl Distribution {
    pub fn draw(&self, stream: Stream, flight: u64) -> Value {
        let between = |[low, high]: [f64; 2], unit: f64| Value::Float(lerp(low, high, unit));
        match self {
            Self::Fixed(value) => value.clone(),
            Self::Choice(values) => {
                let unit = stream.units(flight, 0)[0];
                values[((unit * values.len() as f64) as usize).min(values.len() - 1)].clone()
            }
            Self::Grid { values, stride } => {
                values[(flight / stride % values.len() as u64) as usize].clone()
            }
            Self::Uniform(range) => between(*range, stream.units(flight, 0)[0]),
            Self::LogUniform([low, high]) => {
                let logarithm = lerp(math::ln(*low), math::ln(*high), stream.units(flight, 0)[0]);
                Value::Float(math::exp(logarithm).clamp(*low, *high))
            }
            Self::Latin { range, flights } => between(*range, latin(stream, *flights, flight)),
            Self::Sobol { range, dimension } => between(*range, sobol(stream, *dimension, flight)),
            Self::Normal {
                mean,
                deviation,
                within,
            } => {
                let drawn = |attempt| mean + deviation * normal(stream.units(flight, attempt));
                let is_within =
                    |value: &f64| within.is_none_or(|[low, high]| (low..=high).contains(value));
                let value = (0..ATTEMPTS).map(drawn).find(is_within);
                Value::Float(
                    value.unwrap_or_else(|| {
                        within.map_or(*mean, |[low, high]| mean.clamp(low, high))
                    }),
                )
            }
            Self::Seed => Value::Integer((stream.words(flight, 0)[0] >> 11).cast_signed()),
        }
    }

    /// Values at the ends of what can be drawn: where these fly, those between them do.
    pub fn ends(&self) -> Vec<Value> {
        /// What [`normal`] gives at the most: its first number is 2^-53 at the least.
        const FURTHEST: f64 = 8.572;
        match self {
            Self::Fixed(value) => vec![value.clone()],
            Self::Choice(values) | Self::Grid { values, .. } => values.clone(),
            Self::Normal {
                mean,
                deviation,
                within,
            } => {
                let [low, high] = [mean - FURTHEST * deviation, mean + FURTHEST * deviation];
                let [low, high] = within.map_or([low, high], |[least, most]| {
                    [low.max(least), high.min(most)]
                });
                vec![Value::Float(low), Value::Float(high)]
            }
            Self::Uniform(range)
            | Self::LogUniform(range)
            | Self::Latin { range, .. }
            | Self::Sobol { range, .. } => range.map(Value::Float).into(),
            Self::Seed => vec![Value::Integer(0)],
        }
    }

    /// The same with fractional numbers alone.
    pub fn fractional(self) -> Self {
        let all = |values: Vec<Value>| values.into_iter().map(fractional).collect();
        match self {
            Self::Fixed(value) => Self::Fixed(fractional(value)),
            Self::Choice(values) => Self::Choice(all(values)),
            Self::Grid { values, stride } => Self::Grid {
                values: all(values),
                stride,
            },
            other => other,
        }
    }

    pub fn varies(&self) -> bool {
        match self {
            Self::Fixed(_) => false,
            Self::Choice(values) | Self::Grid { values, .. } => values.len() > 1,
            _ => true,
        }
    }

    /// Whether draws within the bounds come often enough: one in a hundred at the least, by the density and the width.
    pub fn is_likely(&self) -> bool {
        let Self::Normal {
            mean,
            deviation,
            within: Some([low, high]),
        } = self
        else {
            return true;
        };
        let nearest = (mean.clamp(*low, *high) - mean) / deviation;
        let width = ((high - low) / deviation).min(1.0);
        0.4 * math::exp(-0.5 * nearest * nearest) * width > 0.01
    }
}

/// A whole number as a fractional one.
pub(crate) fn fractional(value: Value) -> Value {
    value
        .as_integer()
        .map_or(value, |whole| Value::Float(whole as f64))
}

/// Standard normal, from two numbers from 0 to below 1 (Box and Muller).
fn normal([first, second]: [f64; 2]) -> f64 {
    (-2.0 * math::ln(1.0 - first)).sqrt() * math::cos(std::f64::consts::TAU * second)
}

/// From low to high, never beyond.
fn lerp(low: f64, high: f64, unit: f64) -> f64 {
    (low + (high - low) * unit).clamp(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draws(distribution: &Distribution, flights: u64) -> Vec<f64> {
        let stream = Stream::new(7, "plant.mass_kg");
        (0..flights)
            .map(|flight| distribution.draw(stream, flight).as_float().unwrap())
            .collect()
    }

    /// Share of the draws below a value.
    fn below(draws: &[f64], value: f64) -> f64 {
        draws.iter().filter(|draw| **draw < value).count() as f64 / draws.len() as f64
    }

    #[test]
    fn draws_are_distributed_as_they_are_named() {
        let range = [0.4, 0.8];
        for distribution in [
            Distribution::Uniform(range),
            Distribution::Latin {
                range,
                flights: 4000,
            },
            Distribution::Sobol {
                range,
                dimension: 3,
            },
        ] {
            let draws = draws(&distribution, 4000);
            assert!(draws.iter().all(|draw| (0.4..=0.8).contains(draw)));
            for share in [0.1, 0.5, 0.9] {
                assert!(
                    (below(&draws, 0.4 + 0.4 * share) - share).abs() < 0.02,
                    "{distribution:?} at {share}"
                );
            }
        }
        let log = draws(&Distribution::LogUniform([0.01, 1.0]), 4000);
        assert!(
            (below(&log, 0.1) - 0.5).abs() < 0.02
                && log.iter().all(|draw| (0.01..=1.0).contains(draw))
        );
        let normal = Distribution::Normal {
            mean: 3.0,
            deviation: 2.0,
            within: None,
        };
        let drawn = draws(&normal, 4000);
        for (deviations, share) in [(-1.0, 0.1587), (0.0, 0.5), (2.0, 0.9772)] {
            assert!(
                (below(&drawn, 3.0 + 2.0 * deviations) - share).abs() < 0.02,
                "{deviations}"
            );
        }
        let bounded = Distribution::Normal {
            mean: 3.0,
            deviation: 2.0,
            within: Some([3.0, 4.0]),
        };
        let drawn = draws(&bounded, 1000);
        assert!(
            drawn.iter().all(|draw| (3.0..=4.0).contains(draw))
                && (below(&drawn, 3.5) - 0.5155).abs() < 0.04
        );
    }

    #[test]
    fn grids_are_flown_cell_by_cell_and_choices_evenly() {
        let values: Vec<Value> = ["a", "b", "c"].map(Value::from).into();
        let stream = Stream::new(7, "x");
        let grid = Distribution::Grid {
            values: values.clone(),
            stride: 2,
        };
        let drawn: Vec<Value> = (0..8).map(|flight| grid.draw(stream, flight)).collect();
        assert_eq!(
            drawn,
            ["a", "a", "b", "b", "c", "c", "a", "a"].map(Value::from)
        );
        let choice = Distribution::Choice(values.clone());
        for value in &values {
            let taken = (0..3000)
                .filter(|flight| choice.draw(stream, *flight) == *value)
                .count();
            assert!((900..1100).contains(&taken), "{value}: {taken}");
        }
    }

    #[test]
    fn no_draw_is_beyond_the_ends() {
        let ends = |distribution: Distribution| {
            distribution
                .ends()
                .iter()
                .map(|it| it.as_float().unwrap())
                .collect()
        };
        let wide: Vec<f64> = ends(Distribution::Normal {
            mean: 0.0,
            deviation: 1.0,
            within: None,
        });
        let furthest = normal([1.0 - 2_f64.powi(-53), 0.0]);
        assert!(furthest > 8.5 && furthest < wide[1], "{furthest}");
        let bounded: Vec<f64> = ends(Distribution::Normal {
            mean: 0.0,
            deviation: 1.0,
            within: Some([-1.0, 20.0]),
        });
        assert_eq!(bounded, [-1.0, wide[1]]);
    }

    #[test]
    fn bounds_that_are_hardly_ever_met_are_told() {
        let likely = |low, high| {
            Distribution::Normal {
                mean: 0.0,
                deviation: 1.0,
                within: Some([low, high]),
            }
            .is_likely()
        };
        assert!(likely(-1.0, 1.0) && likely(1.0, 9.0));
        assert!(!likely(4.0, 5.0) && !likely(0.0, 0.001));
    }
}
