//! Refusals: what `ironbird` answers to a wrong command or file, as the pages in `refusals/` show it.
//!
//! A page is run by trycmd. `TRYCMD=overwrite cargo test -p ironbird --test rig refusals` writes today's answers into it.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::{Rig, ironbird};

/// The files that a page shows, each in a fence that names it: "```toml wrong.toml".
fn files(page: &str) -> impl Iterator<Item = (&str, &str)> {
    page.split("\n```").filter_map(|fence| {
        let (head, text) = fence.split_once('\n')?;
        let (_, name) = head
            .split_once(' ')
            .filter(|(kind, _)| ["toml", "csv"].contains(kind))?;
        Some((name, text))
    })
}

/// Puts a page and its files into a rig.
pub fn lay(rig: &Rig, name: &str, page: &str) {
    fs::write(rig.path(name), page).unwrap();
    let directory = rig.path(name).with_extension("in");
    fs::create_dir(&directory).unwrap();
    for (name, text) in files(page) {
        fs::write(directory.join(name), format!("{text}\n")).unwrap();
    }
}

/// Runs the pages of a rig.
pub fn run(rig: &Rig) {
    let cases = trycmd::TestCases::new();
    cases
        .register_bin("ironbird", Path::new(ironbird()))
        .env("IRONBIRD_ROOT", rig.root().to_str().unwrap())
        .case(rig.path("*.md"));
    cases.run();
}

#[test]
fn every_refusal_is_as_its_page_shows_it_and_starts_nothing() {
    let rig = Rig::new("refusals");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/refusals");
    let pages: Vec<PathBuf> = fs::read_dir(source)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert!(pages.len() > 5, "{pages:?}");
    let copy = |page: &Path| rig.path(page.file_name().unwrap().to_str().unwrap());
    let directory = |page: &Path| copy(page).with_extension("in");
    for page in &pages {
        let name = page.file_name().unwrap().to_str().unwrap();
        lay(&rig, name, &fs::read_to_string(page).unwrap());
    }
    let overwrites = std::env::var("TRYCMD").is_ok_and(|it| it == "overwrite");
    run(&rig);
    for page in &pages {
        if overwrites {
            fs::copy(copy(page), page).unwrap();
        }
        let text = fs::read_to_string(page).unwrap();
        let shown: BTreeSet<String> = files(&text).map(|(name, _)| name.to_owned()).collect();
        let left: BTreeSet<String> = fs::read_dir(directory(page))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        assert_eq!(left, shown, "files beside {}", page.display());
    }
    rig.assert_nothing_started();
}

#[test]
fn a_path_that_is_not_utf8_works_or_is_refused_as_such() {
    let rig = Rig::new("utf8");
    let folder = rig.root().join(OsStr::from_bytes(b"n\xff"));
    fs::create_dir_all(&folder).unwrap();
    fs::write(
        folder.join("it.toml"),
        "campaign = { name = \"x\", flights = 2 }\n",
    )
    .unwrap();
    for (words, path) in [
        ("campaign check", "it.toml"),
        ("simulate --trajectory", "it.csv"),
        ("fly --out", "runs"),
    ] {
        let mut command = Command::new(ironbird());
        let command = command.args(words.split(' ')).arg(folder.join(path));
        let said = String::from_utf8(command.output().unwrap().stderr).unwrap();
        assert!(
            said.contains("is not UTF-8, as settings and logs are"),
            "{words}: {said}"
        );
    }
}
