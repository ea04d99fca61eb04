//! Pages of docs/ that tests read: the tutorial, the promises of security. `transcripts/studies.md` has the others.

use crate::c_laws::root;
use crate::rig::{Rig, ironbird, lacks_tool};
use std::fs;
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
