//! The behaviour of commit c92f732, recorded by its executable and kept as text in `golden/`: output hashes, the keys of
//! reports and RESULT lines, exit codes, commands and flags. `replay` flies its recorded flights again.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use clap::CommandFactory as _;
use ironbird::cli::Cli;
use ironbird::manual;
use serde_json::Value;

use crate::rig::{Rig, in_parallel};

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

/// Keys may be added.
#[test]
fn reports_keep_their_json_keys() {
    let lines = lines("report_keys.txt");
    let (flights, objects): (Vec<_>, Vec<_>) = lines.iter().partition(|line| line.contains(" = "));
    in_parallel(flights.into_iter(), |line| {
        let (letter, flight) = line.split_once(" = ").unwrap();
        let rig = Rig::new("golden-keys");
        run(&rig, flight);
        let report = rig.run("report", "--format json").expect(0).json();
        let mut paths = BTreeSet::new();
        key_paths(&report, "", &mut paths);
        let (mut lost, mut known) = (Vec::new(), 0);
        for object in &objects {
            let (letters, keys) = object.split_once(' ').unwrap();
            let (path, keys) = keys.split_once(": ").unwrap();
            for key in keys.split(' ').filter(|_| letters.contains(letter)) {
                let key = format!("{path}.{key}");
                known += 1;
                if !paths.contains(key.trim_start_matches('.')) {
                    lost.push(key);
                }
            }
        }
        assert!(lost.is_empty(), "{flight}: keys are missing: {lost:?}");
        assert!(known > 300, "{flight}: {known} keys");
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

/// Commands and flags may be added.
#[test]
fn help_keeps_its_commands_and_flags() {
    let mut cli = Cli::command();
    cli.build();
    let mut listed = BTreeSet::new();
    for command in manual::all(&cli) {
        let name = manual::page_name(command).replace('-', " ");
        let shown = command.get_arguments().filter(|it| !it.is_hide_set());
        let flags: BTreeSet<&str> = shown.filter_map(|it| it.get_long()).collect();
        assert!(flags.contains("help"), "{name}");
        let flags = flags.iter().filter(|flag| **flag != "help");
        listed.extend(flags.map(|flag| format!("{name} --{flag}")));
        listed.insert(name);
    }
    let (mut known, mut name) = (BTreeSet::new(), String::new());
    for line in lines("commands.txt") {
        match line.strip_prefix("    ") {
            Some(flags) => known.extend(flags.split(' ').map(|flag| format!("{name} {flag}"))),
            None => name.clone_from(&line),
        }
        known.insert(name.clone());
    }
    assert!(known.len() > 200, "{}", known.len());
    let missing: Vec<&String> = known.difference(&listed).collect();
    assert!(missing.is_empty(), "{missing:#?}");
}
