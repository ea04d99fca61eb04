//! The drill's rows are whole: each has an injector and an expectation, and a line of its own in docs/faults.md.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use model::guards::GUARDS;
use serde_json::Value;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// The rows as the drill lists them.
fn rows() -> Vec<Value> {
    let listed = Command::new("python3").arg(root().join("bench/drill/run")).arg("--list").output().unwrap();
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    serde_json::from_slice(&listed.stdout).unwrap()
}

fn text<'a>(row: &'a Value, key: &str) -> &'a str {
    row[key].as_str().unwrap_or_else(|| panic!("no `{key}`: {row}"))
}

#[test]
fn no_row_lacks_an_injector_or_an_expectation() {
    let rows = rows();
    assert!(rows.len() >= 60, "{} rows", rows.len());
    let names: BTreeSet<&str> = rows.iter().map(|row| text(row, "name")).collect();
    assert_eq!(names.len(), rows.len(), "a name twice");
    for row in &rows {
        for key in ["fault", "injector", "expected"] {
            assert!(text(row, key).len() > 3, "{key} of {row}");
        }
        // What is called is there, and says what it does.
        let (module, function) = text(row, "injector").split_once('(').unwrap().0.split_once('.').unwrap();
        let source = fs::read_to_string(root().join(format!("bench/drill/{module}.py"))).unwrap();
        let (_, body) = source.split_once(&format!("\ndef {function}(make, n")).unwrap_or_else(|| panic!("{row}"));
        assert!(
            body.lines().nth(1).unwrap().trim_start().starts_with("\"\"\""),
            "{function} does not say what it does"
        );
        assert!(row["n"].as_u64().unwrap() > 0, "{row}");
    }
}

#[test]
fn every_guard_has_a_row_that_its_absence_turns_red() {
    let rows = rows();
    let named: BTreeSet<&str> =
        rows.iter().flat_map(|row| row["guards"].as_array().unwrap()).map(|guard| guard.as_str().unwrap()).collect();
    assert_eq!(named, GUARDS.iter().map(|(name, _)| *name).collect());
}

#[test]
fn every_row_has_its_line_in_the_page_with_what_became_of_it() {
    let page = fs::read_to_string(root().join("docs/faults.md")).unwrap();
    let data: Value = serde_json::from_str(&fs::read_to_string(root().join("docs/faults.json")).unwrap()).unwrap();
    let known = data["rows"].as_array().unwrap();
    for row in rows() {
        let name = text(&row, "name");
        let is_its = |line: &&str| [" |", " ("].iter().any(|end| line.starts_with(&format!("| `{name}`{end}")));
        let lines: Vec<&str> = page.lines().filter(is_its).collect();
        let [line] = lines[..] else { panic!("{} lines of `{name}` in docs/faults.md", lines.len()) };
        assert!(line.contains(text(&row, "expected")) && line.contains(text(&row, "injector")), "{line}");
        let found = known.iter().find(|found| found["name"] == name).unwrap();
        let [tried, survived] = ["tried", "survived"].map(|key| found[key].as_u64().unwrap());
        let cells: Vec<&str> = line.split(" | ").collect();
        if tried == 0 {
            assert!(cells[4..].iter().any(|cell| cell.starts_with("not tried: ") && cell.len() > 14), "{line}");
        } else {
            let build = text(found, "build");
            assert!(build.starts_with("ironbird ") && !build.contains("mutant"), "{build}");
            assert!(page.contains(&format!("`{build}` on {}", text(found, "date"))));
            assert_eq!(cells[4].split([' ', ',']).next(), Some(tried.to_string().as_str()), "{line}");
            assert_eq!(cells[5], survived.to_string(), "{line}");
        }
    }
}

#[test]
fn trials_are_counted_as_the_page_says() {
    let said = Command::new("python3").arg(root().join("bench/drill/own_tests.py")).output().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
}
