//! Writes messages as CSV rows or JSON lines, driven by their layouts.
//!
//! Numbers are written so that every bit can be read back. What a law shows has rows of its own
//! ([`crate::telemetry`]).

use std::fmt::Write as _;

use messages::header::{Header, Message};
use messages::layout::{self, Field, Kind, Layout as _, Visit, Visitor};

use crate::codec::{Logged, is_telemetry};

/// Names of the columns, as in `envelope.tick` and `position_w_m[2]`.
pub fn columns<C: Logged>() -> Vec<String> {
    let mut columns = Vec::new();
    name_columns("envelope.", Header::FIELDS, &mut columns);
    name_columns("", C::FIELDS, &mut columns);
    columns
}

fn name_columns(path: &str, fields: &[Field], columns: &mut Vec<String>) {
    for field in fields.iter().filter(|field| !is_telemetry(field)) {
        let names = match field.length {
            None => vec![format!("{path}{}", field.name)],
            Some(length) => (0..length)
                .map(|i| format!("{path}{}[{i}]", field.name))
                .collect(),
        };
        for name in names {
            match field.kind {
                Kind::Struct { fields, .. } => name_columns(&format!("{name}."), fields, columns),
                _ => columns.push(name),
            }
        }
    }
}

/// The words of a content in the order of its columns: whole numbers, and the bits of the others.
pub fn words<L: Visit>(content: &L) -> Vec<u64> {
    const WORD: usize = size_of::<u64>();
    let (all, mut words) = (layout::words(content), Vec::new());
    for field in L::FIELDS.iter().filter(|field| !is_telemetry(field)) {
        words.extend(&all[field.offset / WORD..][..field.size / WORD]);
    }
    words
}

/// Name and value of each number of a content, the value in words.
pub fn named<C: Logged>(content: &C) -> Vec<(String, String)> {
    let mut names = Vec::new();
    name_columns("", C::FIELDS, &mut names);
    let mut row = Row::default();
    content.visit(&mut row);
    let values = row.line.split(',').map(str::to_owned);
    names.into_iter().zip(values).collect()
}

pub fn csv<C: Logged>(message: &Message<C>) -> String {
    let mut row = Row::default();
    message.envelope.visit(&mut row);
    message.content.visit(&mut row);
    row.line
}

pub fn json<C: Logged>(message: &Message<C>) -> String {
    let mut object = Object {
        text: "{\"envelope\":".into(),
    };
    object.nested(&message.envelope);
    message.content.visit(&mut object);
    object.text.push('}');
    object.text
}

/// JSON has no numbers that are not finite; no message that passed inspection holds one.
pub(crate) fn json_number(value: f64) -> String {
    match value.is_finite() {
        true => format!("{value:?}"),
        false => "null".into(),
    }
}

#[derive(Default)]
struct Row {
    line: String,
}

impl Row {
    fn push(&mut self, value: std::fmt::Arguments<'_>) {
        if !self.line.is_empty() {
            self.line.push(',');
        }
        // Writing into a string cannot fail.
        let _ = self.line.write_fmt(value);
    }
}

impl Visitor for Row {
    fn integers(&mut self, _: &'static Field, values: &[u64]) {
        for value in values {
            self.push(format_args!("{value}"));
        }
    }

    fn numbers(&mut self, _: &'static Field, values: &[f64]) {
        for value in values {
            self.push(format_args!("{value:?}"));
        }
    }

    fn structs<L: Visit>(&mut self, field: &'static Field, values: &[L]) {
        if !is_telemetry(field) {
            values.iter().for_each(|value| value.visit(self));
        }
    }
}

struct Object {
    text: String,
}

impl Object {
    fn nested<L: Visit>(&mut self, value: &L) {
        self.text.push('{');
        value.visit(self);
        self.text.push('}');
    }

    fn field<T>(&mut self, field: &Field, values: &[T], mut write: impl FnMut(&mut Self, &T)) {
        if !self.text.ends_with('{') {
            self.text.push(',');
        }
        let _ = write!(self.text, "\"{}\":", field.name);
        let (open, close) = field.length.map_or(("", ""), |_| ("[", "]"));
        self.text.push_str(open);
        for (i, value) in values.iter().enumerate() {
            if i > 0 {
                self.text.push(',');
            }
            write(self, value);
        }
        self.text.push_str(close);
    }
}

impl Visitor for Object {
    fn integers(&mut self, field: &'static Field, values: &[u64]) {
        self.field(field, values, |object, value| {
            let _ = write!(object.text, "{value}");
        });
    }

    fn numbers(&mut self, field: &'static Field, values: &[f64]) {
        self.field(field, values, |object, value| {
            let _ = write!(object.text, "{}", json_number(*value));
        });
    }

    fn structs<L: Visit>(&mut self, field: &'static Field, values: &[L]) {
        if !is_telemetry(field) {
            self.field(field, values, |object, value| object.nested(value));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_null_for_numbers_that_are_not_finite() {
        let numbers = [f64::NAN, f64::INFINITY, -0.0].map(json_number);
        assert_eq!(numbers, ["null", "null", "-0.0"]);
    }
}
