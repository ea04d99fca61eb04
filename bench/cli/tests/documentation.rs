//! Pages of docs/ that tests read: the tutorial, the promises of security, the rows of the fault drill.

use crate::c_laws::root;
use crate::python::run_python;
use crate::rig::{Rig, ironbird, lacks_tool};
use messages::checks::Check;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Types the commands of a section of docs/your-law.md in an empty directory, and ends where one fails.
fn type_commands(rig: &Rig, section: &str) {
    let page = read("docs/your-law.md");
    let (_, rest) = page.split_once(&format!("\n## {section}\n")).unwrap();
    let text = rest.split("\n## ").next().unwrap();
    let commands: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("    "))
        .collect();
    assert!(commands.len() >= 5, "{commands:?}");
    fs::create_dir(rig.path("bin")).unwrap();
    std::os::unix::fs::symlink(ironbird(), rig.path("bin/ironbird")).unwrap();
    let path = format!("{}:{}", rig.file("bin"), std::env::var("PATH").unwrap());
    let echoed = commands
        .iter()
        .map(|command| format!("echo '$' {command:?}; {command}\n"));
    let ended = Command::new("sh")
        .args(["-e", "-c", &echoed.collect::<String>()])
        .current_dir(rig.path("."))
        .env("PATH", path)
        .env("IRONBIRD_ROOT", rig.root())
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&ended.stdout);
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "{stdout}\n{stderr}");
    assert!(stdout.contains("identical"), "{stdout}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_in_c_flies_as_the_tutorial_says() {
    let compiler = Command::new("cc").arg("--version").output();
    if !compiler.is_ok_and(|output| output.status.success()) {
        lacks_tool("cc is not there");
        return;
    }
    type_commands(&Rig::new("tutorial_c"), "In C");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_in_rust_flies_as_the_tutorial_says() {
    type_commands(&Rig::new("tutorial_rs"), "In Rust");
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// Whether a source, of Rust or Python, has a test function of this name, or a page of transcripts has the scenario.
fn has_test(source: &str, name: &str) -> bool {
    if [format!("\ndef {name}("), format!("\n## {name}\n")]
        .iter()
        .any(|it| source.contains(it))
    {
        return true;
    }
    let Some(at) = source.find(&format!("fn {name}()")) else {
        return false;
    };
    let before = source[..at].lines().rev().map(str::trim);
    let before = before.filter(|line| !line.is_empty());
    let mut attributes = before.take_while(|line| line.starts_with("#["));
    attributes.any(|line| line == "#[test]")
}

#[test]
fn every_promise_names_its_file_and_a_test_that_is_there() {
    let page = read("docs/security.md");
    let is_row = |line: &&str| {
        line.starts_with('|') && !line.starts_with("|---") && !line.starts_with("| promise")
    };
    let rows = page.lines().filter(is_row);
    let rows: Vec<Vec<&str>> = rows
        .map(|line| line.trim_matches('|').split(" | ").collect())
        .collect();
    assert!(rows.len() >= 15, "{}", rows.len());
    for row in rows {
        let [promise, enforced, shown] = row[..] else {
            panic!("three columns: {row:?}")
        };
        let files = quoted(enforced);
        assert!(!files.is_empty(), "nothing enforces: {promise}");
        files.iter().for_each(|file| drop(read(file)));
        let shown = quoted(shown);
        // A file and a name for each test.
        let (tests, rest) = shown.as_chunks::<2>();
        assert!(
            !tests.is_empty() && rest.is_empty(),
            "no test of: {promise}"
        );
        for [file, name] in tests {
            assert!(has_test(&read(file), name), "{file} has no test {name}");
        }
    }
}

fn rows() -> Vec<Value> {
    let listed = run_python("python3", "bench/drill/run", &[Path::new("--list")]);
    serde_json::from_slice(&listed).unwrap()
}

fn text<'a>(row: &'a Value, key: &str) -> &'a str {
    row[key]
        .as_str()
        .unwrap_or_else(|| panic!("no `{key}`: {row}"))
}

#[test]
fn no_row_lacks_a_scenario_or_an_expectation() {
    let rows = rows();
    assert!(rows.len() >= 60, "{} rows", rows.len());
    let names: BTreeSet<&str> = rows.iter().map(|row| text(row, "name")).collect();
    assert_eq!(names.len(), rows.len(), "a name twice");
    let page = read("bench/cli/tests/transcripts/drill.md");
    for row in &rows {
        for key in ["fault", "expected"] {
            assert!(text(row, key).len() > 3, "{key} of {row}");
        }
        let scenario = format!("\n## {}", text(row, "name"));
        let is_there = row["group"] == "Fault matrix" || page.contains(&scenario);
        assert!(is_there && row["n"].as_u64().unwrap() > 0, "{row}");
    }
}

#[test]
fn every_check_has_a_row_that_its_absence_turns_red() {
    let rows = rows();
    let checks = rows
        .iter()
        .flat_map(|row| row["checks"].as_array().unwrap());
    let named: BTreeSet<&str> = checks.map(|check| check.as_str().unwrap()).collect();
    assert_eq!(named, Check::ALL.map(Check::name).into());
}

#[test]
fn every_row_has_its_line_in_the_page_with_what_became_of_it() {
    let page = read("docs/faults.md");
    let data: Value = serde_json::from_str(&read("docs/faults.json")).unwrap();
    let known = data["rows"].as_array().unwrap();
    let untried = page.split("\n\n");
    let mut untried = untried.filter(|paragraph| paragraph.starts_with("Not tried here"));
    let untried = untried.next().unwrap_or_default();
    for row in rows() {
        let name = text(&row, "name");
        let found = known.iter().find(|found| found["name"] == name).unwrap();
        for key in ["fault", "expected"] {
            assert_eq!(text(found, key), text(&row, key));
        }
        let [tried, survived] = ["tried", "survived"].map(|key| found[key].as_u64().unwrap());
        if tried == 0 && ["lack", "why"].map(|key| text(found, key)) == [""; 2] {
            assert_eq!(untried.matches(&format!("`{name}`")).count(), 1, "{name}");
            continue;
        }
        let is_its = |line: &&str| {
            let names = line.split(" | ").next().unwrap();
            line.starts_with("| `") && names.contains(&format!("`{name}`"))
        };
        let lines: Vec<&str> = page.lines().filter(is_its).collect();
        let [line] = lines[..] else {
            panic!("{} lines of `{name}` in docs/faults.md", lines.len())
        };
        assert!(line.contains(text(&row, "expected")), "{line}");
        let cells: Vec<&str> = line.split(" | ").collect();
        if tried == 0 {
            let is_reason = |cell: &&str| cell.starts_with("not tried: ") && cell.len() > 30;
            assert!(cells[3..].iter().any(is_reason), "{line}");
            continue;
        }
        let build = text(found, "build");
        assert!(
            build.starts_with("ironbird ") && !build.contains("mutant"),
            "{build}"
        );
        assert!(page.contains(&format!("`{build}` on {}", text(found, "date"))));
        let first = cells[3].split([' ', ',']).next().unwrap();
        assert_eq!(
            (first, cells[4]),
            (&*tried.to_string(), &*survived.to_string()),
            "{line}"
        );
    }
}
