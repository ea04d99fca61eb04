//! Reads what a factor is drawn from.

use toml::Value;

use super::Reader;
use crate::campaign::Factor;
use crate::distribution::{Distribution, fractional};
use crate::spread::{SOBOL_DIMENSIONS, SOBOL_FLIGHTS};

/// The ways to draw, by their keys.
const KINDS: [&str; 8] = ["fixed", "choice", "grid", "uniform", "normal", "loguniform", "latin", "sobol"];

/// What the factors so far take.
#[derive(Debug, Default)]
pub(super) struct Taken {
    /// Flights per arm.
    pub flights: u64,
    /// Dimensions of Sobol's sequence.
    dimensions: usize,
}

impl Reader {
    /// What a value of the file draws; none where it is a mistake, which is noted.
    pub(super) fn distribution(&mut self, path: &str, name: &str, value: &Value) -> Option<Distribution> {
        let Some(table) = value.as_table() else { return Some(Distribution::Fixed(value.clone())) };
        let kinds: Vec<&String> = table.keys().filter(|key| *key != "within").collect();
        let [kind] = kinds[..] else {
            self.says(path, format!("`{name}` is drawn in one way: one of {}", KINDS.join(", ")));
            return None;
        };
        let argument = &table[kind.as_str()];
        let distribution = match kind.as_str() {
            "fixed" => Some(Distribution::Fixed(argument.clone())),
            "choice" => self.values(path, kind, argument).map(Distribution::Choice),
            "grid" => self.values(path, kind, argument).map(|values| Distribution::Grid { values, stride: 1 }),
            "uniform" => self.proper(path, kind, argument).map(Distribution::Uniform),
            "loguniform" => self.proper(path, kind, argument).and_then(|range| {
                let is_positive = range[0] > 0.0;
                if !is_positive {
                    self.says(path, format!("loguniform = {argument}: both ends must be above 0"));
                }
                is_positive.then_some(Distribution::LogUniform(range))
            }),
            "latin" => {
                let flights = self.taken.flights;
                self.proper(path, kind, argument).map(|range| Distribution::Latin { range, flights })
            }
            "sobol" => self.sobol(path, kind, argument),
            "normal" => self.normal(path, argument, table.get("within")),
            unknown => {
                self.says(path, format!("`{unknown}` is no way to draw: one of {}", KINDS.join(", ")));
                None
            }
        }?;
        if table.contains_key("within") && kind != "normal" {
            self.says(path, "`within` bounds a normal distribution; the others have their ends");
        }
        if !distribution.is_likely() {
            self.says(path, "fewer than one draw in a hundred would be `within`: widen it, or move the mean");
        }
        Some(distribution)
    }

    fn values(&mut self, path: &str, kind: &str, argument: &Value) -> Option<Vec<Value>> {
        let values: Vec<Value> = argument.as_array().into_iter().flatten().cloned().collect();
        let is_uniform = values.windows(2).all(|pair| pair[0].same_type(&pair[1]));
        // Whole and fractional numbers may be mixed: then all are fractional.
        let values: Vec<Value> = if is_uniform { values } else { values.into_iter().map(fractional).collect() };
        if values.is_empty() || !values.windows(2).all(|pair| pair[0].same_type(&pair[1])) {
            self.says(path, format!("{kind} = {argument}: expected a list of values of one kind, as in [0.4, 0.5]"));
            return None;
        }
        Some(values)
    }

    fn sobol(&mut self, path: &str, kind: &str, argument: &Value) -> Option<Distribution> {
        let range = self.proper(path, kind, argument)?;
        let dimension = self.taken.dimensions;
        self.taken.dimensions += 1;
        if dimension >= SOBOL_DIMENSIONS {
            self.says(path, format!("sobol draws {SOBOL_DIMENSIONS} factors at the most: draw this one as latin"));
        }
        if self.taken.flights > SOBOL_FLIGHTS {
            self.says(path, format!("sobol has {SOBOL_FLIGHTS} points: fly fewer flights"));
        }
        Some(Distribution::Sobol { range, dimension })
    }

    fn normal(&mut self, path: &str, argument: &Value, within: Option<&Value>) -> Option<Distribution> {
        let Some([mean, deviation]) = self.range(argument).filter(|[_, deviation]| *deviation > 0.0) else {
            self.says(path, format!("normal = {argument}: expected [mean, standard deviation], the second above 0"));
            return None;
        };
        let within = match within {
            Some(within) => Some(self.proper(path, "within", within)?),
            None => None,
        };
        Some(Distribution::Normal { mean, deviation, within })
    }

    /// Two numbers, the second above the first.
    fn proper(&mut self, path: &str, kind: &str, argument: &Value) -> Option<[f64; 2]> {
        let range = self.range(argument);
        let proper = range.filter(|[low, high]| low < high);
        if proper.is_none() {
            let why = if range.is_some() { "the range is empty: expected" } else { "expected two numbers," };
            self.says(path, format!("{kind} = {argument}: {why} [low, high] with low below high"));
        }
        proper
    }

    /// Two finite numbers.
    pub(super) fn range(&self, value: &Value) -> Option<[f64; 2]> {
        let number = |value: &Value| value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64));
        let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(number).collect();
        numbers?.try_into().ok().filter(|numbers: &[f64; 2]| numbers.iter().all(|number| number.is_finite()))
    }

    /// Sets the grids' strides: the last one changes with every flight.
    pub(super) fn grids(&mut self, factors: &mut [Factor]) {
        let mut cells: u64 = 1;
        for factor in factors.iter_mut().rev() {
            if let Distribution::Grid { values, stride } = &mut factor.distribution {
                *stride = cells;
                cells = cells.saturating_mul(values.len() as u64);
            }
        }
        if cells > self.taken.flights {
            let flights = self.taken.flights;
            self.says(
                "campaign.flights",
                format!("the grids have {cells} cells, and {flights} flights leave some of them out"),
            );
        }
    }
}
