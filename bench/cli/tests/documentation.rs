//! Pages of docs/ that tests read: the tutorial, the promises of security. `transcripts/studies.md` has the others.

use crate::c_laws::root;
use crate::refusals;
use crate::rig::{Rig, ironbird, lacks_tool};
use clap::Parser as _;
use clap::error::ErrorKind;
use errors::USAGE;
use ironbird::cli::Cli;
use ironbird::manual::page_of;
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

/// A teacher finds the numbers of the page.
#[test]
fn the_class_of_two_hours_shows_what_its_page_says() {
    let rig = Rig::new("class");
    refusals::lay(&rig, "class.md", &read("docs/class.md"));
    refusals::run(&rig);
}

#[test]
fn the_site_replaces_no_directory_that_it_did_not_make() {
    let rig = Rig::new("site");
    fs::create_dir(rig.path("mine")).unwrap();
    fs::write(rig.path("mine/notes"), "notes").unwrap();
    let ended = Command::new(root().join("docs/build"))
        .arg(rig.path("mine"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(said.contains("name another directory"), "{said}");
    assert_eq!(ended.status.code(), Some(2));
    assert_eq!(fs::read(rig.path("mine/notes")).unwrap(), b"notes");
}

#[test]
fn a_script_refuses_an_argument_that_it_does_not_have() {
    let scripts = "docs/build docs/pictures docs/margin-figures dist/notices python/build bench/cli/deaths .ci/again \
                   .ci/check-words .ci/dependencies .ci/release .ci/run .ci/same-bits";
    for script in scripts.split_whitespace() {
        let script = root().join(script);
        let ended = Command::new(&script).arg("--none").output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(2), "{script:?}: {said}");
    }
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

/// The commands of a page: lines of indented or fenced blocks, and words in backquotes.
fn commands(page: &str) -> Vec<Vec<String>> {
    let blocks = page.lines().filter_map(|line| {
        let line = line.strip_prefix("    ").or(line.strip_prefix("$ "))?;
        Some(line.strip_prefix("$ ").unwrap_or(line))
    });
    let is_placeholder = |line: &&str| {
        ["[", "...", " | ", " N", "ironbird 0"]
            .iter()
            .any(|it| line.contains(it))
    };
    let all = blocks.chain(quoted(page));
    let all = all.filter(|line| line.starts_with("ironbird ") && !is_placeholder(line));
    let words = |line: &str| {
        // Up to a comment or a file that the output goes to.
        let typed = line.split(['#', '>']).next().unwrap_or(line);
        let words = typed.split_whitespace();
        words
            .map(|word| word.trim_matches('\'').to_owned())
            .collect()
    };
    all.map(words).collect()
}

#[test]
fn helps_name_pages_as_the_executable_prints_them() {
    let docs = root().join("docs");
    for refusals in fs::read_dir(root().join("bench/cli/tests/refusals")).unwrap() {
        let refusals = fs::read_to_string(refusals.unwrap().path()).unwrap();
        for help in refusals.lines().filter(|line| line.starts_with(" help: ")) {
            assert!(!help.contains("docs/"), "{help}");
            let named = quoted(help).into_iter();
            for page in named.filter_map(|it| it.strip_prefix("ironbird docs ")) {
                page_of(&docs, page).unwrap();
            }
        }
    }
    let failure = page_of(&docs, "campagns").unwrap_err();
    let said = "no page is named `campagns`; did you mean `campaigns`?";
    assert_eq!((failure.code, failure.to_string().as_str()), (USAGE, said));
    assert!(page_of(&docs, "../README").is_err());
    assert!(page_of(&docs, "decisions/README").is_ok());
}

#[test]
fn the_executable_knows_every_command_and_flag_of_the_documentation() {
    let pages = [root().join("README.md"), root().join("CONTRIBUTING.md")].into_iter();
    let docs = fs::read_dir(root().join("docs")).unwrap();
    let docs = docs.map(|entry| entry.unwrap().path());
    let docs = docs.filter(|path| path.extension().is_some_and(|it| it == "md"));
    let mut wrong = Vec::new();
    let mut number = 0;
    for page in pages.chain(docs) {
        for words in commands(&fs::read_to_string(&page).unwrap()) {
            number += 1;
            let refused = Cli::try_parse_from(&words).err();
            // A command may be named without what it needs.
            let needs = [ErrorKind::MissingRequiredArgument, ErrorKind::InvalidValue];
            let is_wrong = |e: &clap::Error| e.use_stderr() && !needs.contains(&e.kind());
            let refused = refused.filter(is_wrong);
            wrong.extend(refused.map(|e| format!("{}: {}: {e}", page.display(), words.join(" "))));
        }
    }
    assert!(number > 100, "{number}");
    assert_eq!(wrong.join("\n"), "");
}
