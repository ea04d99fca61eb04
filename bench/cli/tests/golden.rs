//! The behaviour of commit c92f732, recorded by its executable and kept as text in `golden/`: output hashes, the keys of
//! reports and RESULT lines, exit codes, commands and flags. `replay` flies its recorded flights again.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::rig::{Rig, in_parallel, ironbird};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden");

fn lines(file: &str) -> Vec<String> {
    let text = fs::read_to_string(Path::new(GOLDEN).join(file)).unwrap();
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(str::to_owned)
        .collect()
}

/// Runs a command, with `{golden}` replaced by the path of the data.
fn run(rig: &Rig, command: &str) -> crate::rig::Ended {
    let (command, flags) = command
        .trim_start()
        .split_once(' ')
        .unwrap_or((command, ""));
    rig.run(command, flags.replace("{golden}", GOLDEN))
}

#[test]
fn simulations_have_the_same_output_hashes() {
    let rig = Rig::new("golden-hashes");
    for line in lines("simulate.txt") {
        let (hash, flags) = line.split_once(' ').unwrap();
        run(&rig, &format!("simulate {flags}")).says(&format!(" outputs={hash} "));
    }
}

/// The paths of all keys, with `[]` for every array.
fn key_paths(value: &Value, at: &str, paths: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                let path = if at.is_empty() {
                    key.clone()
                } else {
                    format!("{at}.{key}")
                };
                key_paths(value, &path, paths);
                paths.insert(path);
            }
        }
        Value::Array(items) => {
            for item in items {
                key_paths(item, &format!("{at}[]"), paths);
            }
        }
        _ => {}
    }
}

/// Keys may be added. The first line of each file is the flight.
#[test]
fn reports_keep_their_json_keys() {
    let files = fs::read_dir(Path::new(GOLDEN).join("report_keys")).unwrap();
    let files: Vec<_> = files.map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 6);
    in_parallel(files.into_iter(), |path| {
        let text = fs::read_to_string(path).unwrap();
        let (flight, keys) = text.split_once('\n').unwrap();
        let rig = Rig::new("golden-keys");
        run(&rig, flight.strip_prefix("# ").unwrap());
        let report = rig.run("report", "--format json").expect(0).json();
        let mut paths = BTreeSet::new();
        key_paths(&report, "", &mut paths);
        let lost: Vec<&str> = keys.lines().filter(|key| !paths.contains(*key)).collect();
        assert!(lost.is_empty(), "{flight}: keys are missing: {lost:?}");
    });
}

#[test]
fn result_lines_keep_their_keys() {
    let rig = Rig::new("golden-result");
    for pair in lines("result_keys.txt").chunks(2) {
        let [command, keys] = pair else {
            panic!("no keys for {pair:?}")
        };
        let ended = run(&rig, command).expect(0);
        let line = ended.stdout.lines().last().unwrap();
        let found: Vec<&str> = line
            .strip_prefix("RESULT ")
            .unwrap()
            .split(' ')
            .map(|field| field.split('=').next().unwrap())
            .collect();
        let expected: Vec<&str> = keys.split_whitespace().collect();
        assert_eq!(found, expected, "{ended}");
    }
}

#[test]
fn exit_codes_stay() {
    let rig = Rig::new("golden-codes");
    for line in lines("exit_codes.txt") {
        let (code, command) = line.split_once(' ').unwrap();
        run(&rig, command).expect(code.parse().unwrap());
    }
}

fn listed(help: &str) -> (BTreeSet<String>, Vec<String>) {
    let mut flags = BTreeSet::new();
    let mut commands = Vec::new();
    let mut section = "";
    for line in help.lines() {
        let word = line.trim_start();
        let indent = line.len() - word.len();
        if indent == 0 && !line.is_empty() {
            section = line;
        }
        let first = word.split_whitespace().next().unwrap_or_default();
        if section == "Commands:" && indent == 2 && first != "help" {
            commands.push(first.to_owned());
        } else if indent <= 8 && first.starts_with('-') {
            flags.extend(
                word.split_whitespace()
                    .take(2)
                    .filter(|name| name.starts_with("--"))
                    .map(str::to_owned),
            );
        }
    }
    (flags, commands)
}

fn list_commands(path: &[String], list: &mut Vec<(String, BTreeSet<String>)>) {
    let output = Command::new(ironbird())
        .args(path)
        .arg("--help")
        .output()
        .unwrap();
    let (flags, commands) = listed(&String::from_utf8_lossy(&output.stdout));
    list.push((path.join(" "), flags));
    for command in commands {
        list_commands(&[path, &[command]].concat(), list);
    }
}

/// To add or rename a command or a flag, edit `golden/commands.txt`.
#[test]
fn help_lists_the_same_commands_and_flags() {
    let mut list = Vec::new();
    list_commands(&[], &mut list);
    list.sort();
    let mut found = Vec::new();
    for (path, flags) in list {
        found.push(format!("ironbird {path}").trim_end().to_owned());
        found.extend(flags.into_iter().map(|flag| format!("    {flag}")));
    }
    assert_eq!(found.join("\n"), lines("commands.txt").join("\n"));
}
