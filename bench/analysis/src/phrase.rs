//! Numbers with a noun, lists, the names of values, and sentences wrapped for a terminal.

use serde::Serialize;
use serde_json::Value;
use textwrap::{Options, WordSplitter};

pub const WIDTH: usize = 80;
/// Every line of a sentence after the first begins with this.
pub const INDENT: &str = "          ";

pub fn wrap(sentence: &str) -> Vec<String> {
    let options = Options::new(WIDTH)
        .subsequent_indent(INDENT)
        .word_splitter(WordSplitter::NoHyphenation);
    textwrap::wrap(sentence, options)
        .into_iter()
        .map(Into::into)
        .collect()
}

pub fn count(number: u64, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

/// Items with commas between them.
pub fn list(items: impl IntoIterator<Item = impl ToString>) -> String {
    let items: Vec<String> = items.into_iter().map(|item| item.to_string()).collect();
    items.join(", ")
}

/// A part of a sentence with what surrounds it; empty without that part.
pub fn surrounded(before: &str, part: &str, after: &str) -> String {
    match part {
        "" => String::new(),
        part => format!("{before}{part}{after}"),
    }
}

/// A number with these digits after the point; with as many more as it takes to show on which side of its limit it is.
pub fn beside(number: f64, limit: f64, digits: usize) -> String {
    const MOST: usize = 17;
    let texts = (digits..MOST).map(|digits| format!("{number:.digits$}"));
    let shows = |text: &String| {
        let shown = text.parse::<f64>();
        shown.is_ok_and(|shown: f64| shown.partial_cmp(&limit) == number.partial_cmp(&limit))
    };
    let mut texts = texts.filter(shows);
    texts.next().unwrap_or_else(|| number.to_string())
}

/// The name of a variant as in report.json, with spaces: `not measured`.
pub fn name_of(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(name)) => name.replace('_', " "),
        _ => String::new(),
    }
}
