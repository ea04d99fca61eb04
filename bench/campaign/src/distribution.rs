//! What a factor may be drawn from, and the value that a flight draws.

use messages::math;
use toml::Value;

use crate::generator::Stream;
use crate::spread::{latin, sobol};

#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    Fixed(Value),
    Choice(Vec<Value>),
    /// All combinations of all grids in turn; in the campaign's grids, the value changes every `stride` flights.
    Grid {
        values: Vec<Value>,
        stride: u64,
    },
    Uniform([f64; 2]),
    /// Normal, by mean and standard deviation; draws beyond the bounds are drawn again.
    Normal {
        mean: f64,
        deviation: f64,
        within: Option<[f64; 2]>,
    },
    LogUniform([f64; 2]),
    /// From low to high, with one flight in each of as many strata as there are flights.
    Latin {
        range: [f64; 2],
        flights: u64,
    },
    /// From low to high, by a dimension of Sobol's sequence.
    Sobol {
        range: [f64; 2],
        dimension: usize,
    },
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
                let nearest = || within.map_or(*mean, |[low, high]| mean.clamp(low, high));
                Value::Float(value.unwrap_or_else(nearest))
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
                let [least, most] = within.unwrap_or([low, high]);
                vec![Value::Float(low.max(least)), Value::Float(high.min(most))]
            }
            Self::Uniform(range)
            | Self::LogUniform(range)
            | Self::Latin { range, .. }
            | Self::Sobol { range, .. } => range.map(Value::Float).into(),
            Self::Seed => vec![Value::Integer(0)],
        }
    }

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

pub(crate) fn fractional(value: Value) -> Value {
    let whole = value.as_integer();
    whole.map_or(value, |whole| Value::Float(whole as f64))
}

/// Standard normal, from two numbers from 0 to below 1 (Box and Muller).
fn normal([first, second]: [f64; 2]) -> f64 {
    (-2.0 * math::ln(1.0 - first)).sqrt() * math::cos(std::f64::consts::TAU * second)
}

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

    fn below(draws: &[f64], value: f64) -> f64 {
        draws.iter().filter(|draw| **draw < value).count() as f64 / draws.len() as f64
    }

    const fn normal_distribution(
        mean: f64,
        deviation: f64,
        within: Option<[f64; 2]>,
    ) -> Distribution {
        Distribution::Normal {
            mean,
            deviation,
            within,
        }
    }

    #[test]
    fn draws_are_distributed_as_they_are_named() {
        let range = [0.4, 0.8];
        let (flights, dimension) = (4000, 3);
        let linear = [(0.44, 0.1), (0.6, 0.5), (0.76, 0.9)];
        for (distribution, [low, high], shares) in [
            (Distribution::Uniform(range), range, linear),
            (Distribution::Latin { range, flights }, range, linear),
            (Distribution::Sobol { range, dimension }, range, linear),
            (
                Distribution::LogUniform([0.01, 1.0]),
                [0.01, 1.0],
                [(0.1, 0.5); 3],
            ),
            (
                normal_distribution(3.0, 2.0, None),
                [f64::MIN, f64::MAX],
                [(1.0, 0.1587), (3.0, 0.5), (7.0, 0.9772)],
            ),
            (
                normal_distribution(3.0, 2.0, Some([3.0, 4.0])),
                [3.0, 4.0],
                [(3.5, 0.5155); 3],
            ),
        ] {
            let draws = draws(&distribution, flights);
            assert!(draws.iter().all(|draw| (low..=high).contains(draw)));
            for (value, share) in shares {
                let is_near = (below(&draws, value) - share).abs() < 0.02;
                assert!(is_near, "{distribution:?} below {value}");
            }
        }
    }

    #[test]
    fn grids_are_flown_cell_by_cell_and_choices_evenly() {
        let values: Vec<Value> = [0, 1, 2].map(|it| Value::Float(f64::from(it))).into();
        let (grid, choice) = (values.clone(), Distribution::Choice(values));
        let grid = Distribution::Grid {
            values: grid,
            stride: 2,
        };
        assert_eq!(draws(&grid, 8), [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 0.0, 0.0]);
        let draws = draws(&choice, 3000);
        for (value, share) in [(0.5, 1.0 / 3.0), (1.5, 2.0 / 3.0)] {
            assert!((below(&draws, value) - share).abs() < 0.03, "{value}");
        }
    }

    #[test]
    fn no_draw_is_beyond_the_ends() {
        let ends = |distribution: Distribution| {
            let ends = distribution.ends().into_iter();
            ends.map(|end| end.as_float().unwrap()).collect::<Vec<_>>()
        };
        let wide = ends(normal_distribution(0.0, 1.0, None));
        let furthest = normal([1.0 - 2_f64.powi(-53), 0.0]);
        assert!(furthest > 8.5 && furthest < wide[1], "{furthest}");
        let bounded = ends(normal_distribution(0.0, 2.0, Some([-1.0, 20.0])));
        assert_eq!(bounded, [-1.0, 2.0 * wide[1]]);
    }
}
