//! A fault of a campaign: what is drawn of it, and the same in the words of `--fault`.

use std::time::Duration;

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

/// What a number that is drawn for a fault stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    Plain,
    Ticks,
    Time,
    None,
}

impl Number {
    pub fn of(what: &str) -> Self {
        match what.rsplit_once('.').map(|(_, word)| word) {
            Some("stop" | "late") => Self::Time,
            Some("delay" | "lag") => Self::Ticks,
            Some("freeze" | "nan" | "kill") => Self::None,
            _ => Self::Plain,
        }
    }

    /// Its unit, where it is not that of what is changed.
    pub const fn unit(self) -> Option<&'static str> {
        match self {
            Self::Plain => None,
            Self::Ticks => Some("ticks"),
            Self::Time => Some("s"),
            Self::None => Some(""),
        }
    }

    fn text(self, value: &Value) -> String {
        match (self, value) {
            (Self::None, _) => String::new(),
            (_, Value::String(text)) => format!("={text}"),
            (Self::Time, Value::Float(seconds)) => format!("={}ns", nanoseconds(*seconds)),
            (Self::Ticks, Value::Float(ticks)) => format!("={ticks:.0}"),
            (_, Value::Float(number)) => format!("={number:?}"),
            (_, other) => format!("={other}"),
        }
    }
}

pub fn is_of_the_loop(what: &str) -> bool {
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
            .map_or_else(String::new, |place| Number::of(what).text(&draws[place]));
        let over = self.over_s.map(|over| nanoseconds(time(over)));
        let over = over.map_or_else(String::new, |over_ns| format!("~{over_ns}ns"));
        let at_s = time(self.at_s);
        let to = self.for_s.map_or_else(String::new, |lasts| {
            format!("..{}ns", nanoseconds(at_s + time(lasts)))
        });
        format!("{what}{value}{over}@{}ns{to}", nanoseconds(at_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_written_as_its_fault_has_it() {
        for (what, value, for_s, expected) in [
            (
                "mass_kg",
                Some(0.6.into()),
                None,
                "mass_kg=0.6@1500000000ns",
            ),
            (
                "state.drop",
                Some(0.25.into()),
                Some(0.5),
                "state.drop=0.25@1500000000ns..2000000000ns",
            ),
            (
                "state.drop",
                Some("5/25".into()),
                None,
                "state.drop=5/25@1500000000ns",
            ),
            (
                "inner.stop",
                Some(0.02.into()),
                None,
                "inner.stop=20000000ns@1500000000ns",
            ),
            (
                "inner.late",
                Some("1ms..3ms".into()),
                Some(1.0),
                "inner.late=1ms..3ms@1500000000ns..2500000000ns",
            ),
            (
                "inner.state.lag",
                Some(3.0.into()),
                None,
                "inner.state.lag=3@1500000000ns",
            ),
            ("outer.kill", None, None, "outer.kill@1500000000ns"),
            (
                "state.freeze",
                Some(1.0.into()),
                Some(1.0),
                "state.freeze@1500000000ns..2500000000ns",
            ),
        ] {
            let fault = Fault {
                what: 0,
                value: value.is_some().then_some(1),
                at_s: 2,
                over_s: None,
                for_s: for_s.map(|_| 3),
            };
            let value = value.unwrap_or(Value::Boolean(false));
            let for_s = for_s.unwrap_or_default();
            let draws = [what.into(), value, 1.5.into(), for_s.into()];
            assert_eq!(fault.text(&draws), expected);
        }
    }
}
