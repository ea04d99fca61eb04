//! The tutorial's commands, as a newcomer types them. Those in Python: `python/tests/test_docs.py`.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::rig::{IRONBIRD, Rig, lacks_tool};

/// The commands of a section of docs/your-law.md, in order.
fn commands(section: &str) -> Vec<String> {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/your-law.md");
    let page = fs::read_to_string(page).unwrap();
    let (_, rest) = page.split_once(&format!("\n## {section}\n")).unwrap();
    let text = rest.split("\n## ").next().unwrap();
    text.lines().filter_map(|line| line.strip_prefix("    ")).map(str::to_owned).collect()
}

/// Types them in an empty directory, and ends where one fails.
fn typed(rig: &Rig, section: &str) {
    let commands = commands(section);
    assert!(commands.len() >= 5, "{commands:?}");
    let bin: PathBuf = rig.path("bin");
    fs::create_dir(&bin).unwrap();
    std::os::unix::fs::symlink(IRONBIRD, bin.join("ironbird")).unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let script = commands.iter().map(|command| format!("echo '$' {command:?}; {command}\n")).collect::<String>();
    let ended = Command::new("sh")
        .args(["-e", "-c", &script])
        .current_dir(rig.path("."))
        .env("PATH", path)
        .env("IRONBIRD_ROOT", rig.root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stdout);
    assert!(ended.status.success(), "{said}\n{}", String::from_utf8_lossy(&ended.stderr));
    assert!(said.contains("identical"), "{said}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_in_c_flies_as_the_tutorial_says() {
    if !Command::new("cc").arg("--version").output().is_ok_and(|it| it.status.success()) {
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
