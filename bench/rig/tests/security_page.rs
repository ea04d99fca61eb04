//! docs/security.md: every promise names what enforces it and a test that shows it, and both are there.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::Path;

const PAGE: &str = include_str!("../../../docs/security.md");

fn source(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    fs::read_to_string(root.join(path)).unwrap_or_else(|e| panic!("docs/security.md names {path}: {e}"))
}

/// What stands in backticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// Whether a source, of Rust or Python, has a test function of this name.
fn has_test(source: &str, name: &str) -> bool {
    if name.starts_with("test_") {
        return source.contains(&format!("\ndef {name}("));
    }
    let Some(at) = source.find(&format!("fn {name}()")) else { return false };
    let before = source[..at].lines().rev().map(str::trim).filter(|line| !line.is_empty());
    before.take_while(|line| line.starts_with("#[")).any(|line| line == "#[test]")
}

#[test]
fn every_promise_names_its_file_and_a_test_that_is_there() {
    let rows: Vec<Vec<&str>> = PAGE
        .lines()
        .filter(|line| line.starts_with('|') && !line.starts_with("|---") && !line.starts_with("| promise"))
        .map(|line| line.trim_matches('|').split(" | ").collect())
        .collect();
    assert!(rows.len() >= 15, "{}", rows.len());
    for row in rows {
        let [promise, enforced, shown] = row[..] else { panic!("three columns: {row:?}") };
        let files = quoted(enforced);
        assert!(!files.is_empty(), "nothing enforces: {promise}");
        files.iter().for_each(|file| drop(source(file)));
        let shown = quoted(shown);
        assert!(!shown.is_empty() && shown.len().is_multiple_of(2), "no test, in file and name, of: {promise}");
        for test in shown.chunks(2) {
            let [file, name] = test else { unreachable!("chunks of two") };
            assert!(has_test(&source(file), name), "{file} has no test {name}");
        }
    }
}
