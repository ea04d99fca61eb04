//! A fault of a campaign: its factors, and its text as `--fault` takes it.

use std::time::Duration;

use faults::{FAULTS, ValueType};
use toml::Value;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// What: a parameter, or a fault of messages or stages.
    pub what: usize,
    /// Its value; none where it takes none.
    pub value: Option<usize>,
    pub at_s: usize,
    /// How long a parameter takes to get there [s]; at once without.
    pub over_s: Option<usize>,
    /// How long a fault of messages or stages lasts [s]; for good, or once, without.
    pub for_s: Option<usize>,
}

/// What a value drawn for a fault is; for a parameter, a number.
pub fn value_type(what: &str) -> ValueType {
    let (_, kind) = what.rsplit_once('.').unwrap_or_default();
    let spec = FAULTS.iter().find(|spec| spec.name == kind);
    spec.map_or(ValueType::NotZero, |spec| spec.value)
}

/// A drawn value, as `--fault` takes it after the kind.
fn value_text(value_type: ValueType, value: &Value) -> String {
    use ValueType as V;
    match (value_type, value) {
        (V::None, _) => String::new(),
        (_, Value::String(text)) => format!("={text}"),
        (V::Time | V::TimeRange, Value::Float(seconds)) => format!("={}ns", nanoseconds(*seconds)),
        (V::Integer { .. }, Value::Float(number)) => format!("={number:.0}"),
        (_, Value::Float(number)) => format!("={number:?}"),
        (_, other) => format!("={other}"),
    }
}

pub fn is_loop_fault(what: &str) -> bool {
    what.contains('.')
}

/// The flag reads whole numbers alone; times are checked where the file is read.
fn nanoseconds(seconds: f64) -> u128 {
    Duration::try_from_secs_f64(seconds)
        .unwrap_or_default()
        .as_nanos()
}

impl Fault {
    pub fn what<'a>(&self, draws: &'a [Value]) -> &'a str {
        draws[self.what].as_str().unwrap_or_default()
    }

    pub fn text(&self, draws: &[Value]) -> String {
        let time = |place: usize| draws[place].as_float().unwrap_or_default();
        let what = self.what(draws);
        let value = self
            .value
            .map(|place| value_text(value_type(what), &draws[place]));
        let over = self.over_s.map(|over| nanoseconds(time(over)));
        let over = over.map(|over_ns| format!("~{over_ns}ns"));
        let at_s = time(self.at_s);
        let to = self.for_s.map(|lasts| nanoseconds(at_s + time(lasts)));
        let to = to.map(|to_ns| format!("..{to_ns}ns"));
        let [value, over, to] = [value, over, to].map(Option::unwrap_or_default);
        format!("{what}{value}{over}@{}ns{to}", nanoseconds(at_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_written_as_its_fault_has_it() {
        for row in [
            "mass_kg | 0.6 | | mass_kg=0.6@1500000000ns",
            "state.drop | 0.25 | 0.5 | state.drop=0.25@1500000000ns..2000000000ns",
            "state.drop | \"5/25\" | | state.drop=5/25@1500000000ns",
            "inner.stop | 0.02 | | inner.stop=20000000ns@1500000000ns",
            "inner.late | \"1ms..3ms\" | 1.0 | inner.late=1ms..3ms@1500000000ns..2500000000ns",
            "inner.state.lag | 3.0 | | inner.state.lag=3@1500000000ns",
            "outer.kill | | | outer.kill@1500000000ns",
            "state.freeze | 1.0 | 1.0 | state.freeze@1500000000ns..2500000000ns",
        ] {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            let draw = |cell: &str| cell.parse().unwrap_or(Value::Boolean(false));
            let fault = Fault {
                what: 0,
                value: (!cells[1].is_empty()).then_some(1),
                at_s: 2,
                over_s: None,
                for_s: (!cells[2].is_empty()).then_some(3),
            };
            let draws = [cells[0].into(), draw(cells[1]), 1.5.into(), draw(cells[2])];
            assert_eq!(fault.text(&draws), cells[3]);
        }
    }
}
