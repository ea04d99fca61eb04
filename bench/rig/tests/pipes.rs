//! Pipes in place of the files that flags name: read, and read by nobody.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::process::Command;

use crate::rig::{Rig, Running, wait_until};

const SHORT: [&str; 4] = ["--pace", "lockstep", "--duration", "500ms"];

fn make_pipe(rig: &Rig, name: &str) -> String {
    let pipe = rig.file(name);
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    pipe
}

/// A pipe, and who reads it: until the first one who writes closes it.
fn read_pipe(rig: &Rig, name: &str) -> (String, Running) {
    let pipe = make_pipe(rig, name);
    let mut reader = Command::new("cat");
    reader.arg(&pipe);
    let reader = rig.launch(reader);
    // It sleeps until somebody writes, and not before it has the pipe.
    let stat = || fs::read_to_string(format!("/proc/{}/stat", reader.pid())).unwrap();
    wait_until("the pipe's reader", || stat().contains("(cat) S ").then_some(()));
    (pipe, reader)
}

#[test]
fn who_reads_a_pipe_gets_what_would_be_in_the_file() {
    let rig = Rig::new("piped");
    let ((states, states_reader), (junit, junit_reader)) = (read_pipe(&rig, "states"), read_pipe(&rig, "junit"));
    rig.run("fly", &[&SHORT[..], &["--states", &states, "--junit", &junit]].concat()).expect(0);
    let flown = fs::read_to_string(rig.out().join("latest/states.csv")).unwrap();
    assert_eq!(states_reader.end().expect(0).stdout, flown);
    let of_flight = junit_reader.end().expect(0).stdout;
    assert!(of_flight.contains("<testsuite ") && of_flight.ends_with("</testsuites>\n"), "{of_flight}");
    let (junit, junit_reader) = read_pipe(&rig, "again");
    rig.run("report", &["--junit", &junit]).expect(0);
    assert_eq!(junit_reader.end().expect(0).stdout, of_flight);
    let ((states, states_reader), (plot, plot_reader)) = (read_pipe(&rig, "simulated"), read_pipe(&rig, "plot.svg"));
    rig.run("simulate", &["--duration", "500ms", "--states", &states, "--plot", &plot]).expect(0);
    assert_eq!(states_reader.end().expect(0).stdout, flown);
    assert!(plot_reader.end().expect(0).stdout.ends_with("</svg>"));
}

#[test]
fn a_pipe_that_nobody_reads_is_named_and_waited_for_by_nobody() {
    let rig = Rig::new("unread");
    let pipe = make_pipe(&rig, "pipe.svg");
    let words = format!("{pipe}: it is a pipe that nobody reads");
    for flag in ["--states", "--plot"] {
        rig.run("simulate", &["--duration", "100ms", flag, &pipe]).expect(1).complains(&words);
    }
    rig.run("fly", &[&SHORT[..], &["--states", &pipe]].concat()).expect(1).complains(&words);
    assert!(rig.run_directories().is_empty(), "{:?}", rig.run_directories());
    let flown = rig.run("fly", &[&SHORT[..], &["--junit", &pipe]].concat()).expect(1).complains(&words);
    assert_eq!(flown.result()["status"], "PASS", "{flown}");
    rig.run("report", &["--junit", &pipe]).expect(1).complains(&words);
    rig.assert_nothing_left();
}
