//! Pages of docs/ that tests read: the tutorial, the promises of security, the rows of the fault drill.

use crate::rig::{IRONBIRD, Rig, lacks_tool};
use messages::checks::GUARDS;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The commands of a section of docs/your-law.md, in order.
fn commands(section: &str) -> Vec<String> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/your-law.md");
    let page = fs::read_to_string(page).unwrap();
    let (_, rest) = page.split_once(&format!("\n## {section}\n")).unwrap();
    let text = rest.split("\n## ").next().unwrap();
    text.lines()
        .filter_map(|line| line.strip_prefix("    "))
        .map(str::to_owned)
        .collect()
}

/// Types them in an empty directory, and ends where one fails.
fn typed(rig: &Rig, section: &str) {
    let commands = commands(section);
    assert!(commands.len() >= 5, "{commands:?}");
    let bin: PathBuf = rig.path("bin");
    fs::create_dir(&bin).unwrap();
    std::os::unix::fs::symlink(IRONBIRD, bin.join("ironbird")).unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let script = commands
        .iter()
        .map(|command| format!("echo '$' {command:?}; {command}\n"))
        .collect::<String>();
    let ended = Command::new("sh")
        .args(["-e", "-c", &script])
        .current_dir(rig.path("."))
        .env("PATH", path)
        .env("IRONBIRD_ROOT", rig.root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stdout);
    assert!(
        ended.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&ended.stderr)
    );
    assert!(said.contains("identical"), "{said}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_in_c_flies_as_the_tutorial_says() {
    if !Command::new("cc")
        .arg("--version")
        .output()
        .is_ok_and(|it| it.status.success())
    {
        lacks_tool("cc is not there");
        return;
    }
    typed(&Rig::new("tutorial_c"), "In C");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_in_rust_flies_as_the_tutorial_says() {
    typed(&Rig::new("tutorial_rs"), "In Rust");
}

const PAGE: &str = include_str!("../../../docs/security.md");

fn source(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    fs::read_to_string(root.join(path))
        .unwrap_or_else(|e| panic!("docs/security.md names {path}: {e}"))
}

fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// Whether a source, of Rust or Python, has a test function of this name.
fn has_test(source: &str, name: &str) -> bool {
    if name.starts_with("test_") {
        return source.contains(&format!("\ndef {name}("));
    }
    let Some(at) = source.find(&format!("fn {name}()")) else {
        return false;
    };
    let before = source[..at]
        .lines()
        .rev()
        .map(str::trim)
        .filter(|line| !line.is_empty());
    before
        .take_while(|line| line.starts_with("#["))
        .any(|line| line == "#[test]")
}

#[test]
fn every_promise_names_its_file_and_a_test_that_is_there() {
    let rows: Vec<Vec<&str>> = PAGE
        .lines()
        .filter(|line| {
            line.starts_with('|') && !line.starts_with("|---") && !line.starts_with("| promise")
        })
        .map(|line| line.trim_matches('|').split(" | ").collect())
        .collect();
    assert!(rows.len() >= 15, "{}", rows.len());
    for row in rows {
        let [promise, enforced, shown] = row[..] else {
            panic!("three columns: {row:?}")
        };
        let files = quoted(enforced);
        assert!(!files.is_empty(), "nothing enforces: {promise}");
        files.iter().for_each(|file| drop(source(file)));
        let shown = quoted(shown);
        assert!(
            !shown.is_empty() && shown.len().is_multiple_of(2),
            "no test, in file and name, of: {promise}"
        );
        for test in shown.chunks(2) {
            let [file, name] = test else {
                unreachable!("chunks of two")
            };
            assert!(has_test(&source(file), name), "{file} has no test {name}");
        }
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// The rows as the drill lists them.
fn rows() -> Vec<Value> {
    let listed = Command::new("python3")
        .arg(root().join("bench/drill/run"))
        .arg("--list")
        .output()
        .unwrap();
    assert!(
        listed.status.success(),
        "{}",
        String::from_utf8_lossy(&listed.stderr)
    );
    serde_json::from_slice(&listed.stdout).unwrap()
}

fn text<'a>(row: &'a Value, key: &str) -> &'a str {
    row[key]
        .as_str()
        .unwrap_or_else(|| panic!("no `{key}`: {row}"))
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
        let (module, function) = text(row, "injector")
            .split_once('(')
            .unwrap()
            .0
            .split_once('.')
            .unwrap();
        let source = fs::read_to_string(root().join(format!("bench/drill/{module}.py"))).unwrap();
        let (_, body) = source
            .split_once(&format!("\ndef {function}(make, n"))
            .unwrap_or_else(|| panic!("{row}"));
        assert!(
            body.lines()
                .nth(1)
                .unwrap()
                .trim_start()
                .starts_with("\"\"\""),
            "{function} does not say what it does"
        );
        assert!(row["n"].as_u64().unwrap() > 0, "{row}");
    }
}

#[test]
fn every_guard_has_a_row_that_its_absence_turns_red() {
    let rows = rows();
    let named: BTreeSet<&str> = rows
        .iter()
        .flat_map(|row| row["guards"].as_array().unwrap())
        .map(|guard| guard.as_str().unwrap())
        .collect();
    assert_eq!(named, GUARDS.iter().map(|(name, _)| *name).collect());
}

#[test]
fn every_row_has_its_line_in_the_page_with_what_became_of_it() {
    let page = fs::read_to_string(root().join("docs/faults.md")).unwrap();
    let data: Value =
        serde_json::from_str(&fs::read_to_string(root().join("docs/faults.json")).unwrap())
            .unwrap();
    let known = data["rows"].as_array().unwrap();
    for row in rows() {
        let name = text(&row, "name");
        let is_its = |line: &&str| {
            line.split(" | ")
                .next()
                .is_some_and(|names| names.contains(&format!("`{name}`")))
                && line.starts_with("| `")
        };
        let lines: Vec<&str> = page.lines().filter(is_its).collect();
        let [line] = lines[..] else {
            panic!("{} lines of `{name}` in docs/faults.md", lines.len())
        };
        let found = known.iter().find(|found| found["name"] == name).unwrap();
        assert!(line.contains(text(&row, "expected")), "{line}");
        for key in ["injector", "fault", "expected"] {
            assert_eq!(text(found, key), text(&row, key));
        }
        let [tried, survived] = ["tried", "survived"].map(|key| found[key].as_u64().unwrap());
        let cells: Vec<&str> = line.split(" | ").collect();
        if tried == 0 {
            assert!(
                cells[3..]
                    .iter()
                    .any(|cell| cell.starts_with("not tried: ") && cell.len() > 14),
                "{line}"
            );
        } else {
            let build = text(found, "build");
            assert!(
                build.starts_with("ironbird ") && !build.contains("mutant"),
                "{build}"
            );
            assert!(page.contains(&format!("`{build}` on {}", text(found, "date"))));
            assert_eq!(
                cells[3].split([' ', ',']).next(),
                Some(tried.to_string().as_str()),
                "{line}"
            );
            assert_eq!(cells[4], survived.to_string(), "{line}");
        }
    }
}
