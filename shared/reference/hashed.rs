//! Long texts in snapshots: the figures that a person checks, and a hash that changes with any byte.
//!
//! The tests of several crates include this file.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde_json::Value;
use sha2::{Digest as _, Sha256};

/// Writes the text to `CRATE-NAME.HASH` in `tmp/` of cargo's target directory, and returns that name and what is shown.
///
/// When the hash differs, compare the file with the one of the snapshot's hash, which the test writes on the commit before.
pub fn hashed(name: &str, text: &str, shown: &str) -> String {
    let hash = format!("{:x}", Sha256::digest(text));
    let file = format!("{}-{name}.{}", env!("CARGO_PKG_NAME"), &hash[..16]);
    fs::write(Path::new(env!("CARGO_TARGET_TMPDIR")).join(&file), text).unwrap();
    let (lines, bytes) = (text.lines().count(), text.len());
    format!("target/tmp/{file}: {lines} lines, {bytes} bytes\n{shown}")
}

/// A line for each place, or for each element where an array is there: its values of these keys, which may be paths.
#[allow(dead_code, reason = "no crate uses all of it")]
pub fn figures(document: &Value, places: &[(&str, &str)]) -> String {
    let mut text = String::new();
    for (place, keys) in places {
        let elements = match document.pointer(place).unwrap() {
            Value::Array(elements) => elements.iter().collect(),
            other => vec![other],
        };
        for element in elements {
            text += if place.is_empty() { "/" } else { place };
            for key in keys.split(' ') {
                match element.pointer(&format!("/{key}")) {
                    Some(value) => write!(text, " {key} {value}").unwrap(),
                    None => write!(text, " {key} -").unwrap(),
                }
            }
            text += "\n";
        }
    }
    text
}
